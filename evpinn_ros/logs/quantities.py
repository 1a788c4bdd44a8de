"""Names and units of the columns of log apps, as one table; a name is matched by its words.

Sources: exports of Car Scanner and LeafSpy; Torque as read by torque-visualizer and torque2influx;
OBD Fusion; OVMS' metrics (docs.openvehicles.com); ABRP's telemetry (documenter.getpostman.com);
TeslaMate's `positions`; UN GTR 15; the Vehicle Energy Dataset.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, lru_cache
from itertools import pairwise
import math
import re
from typing import NamedTuple


class Unit(NamedTuple):
    """A unit: SI value = number in the file * `factor` + `offset`."""

    factor: float
    offset: float = 0.0


class ColumnQuantity(NamedTuple):
    """A quantity of a column, with phrases of its names as comma-separated text."""

    column: str  # our own name, with the unit in it
    words: str  # phrases, one of which a name must contain
    # by lower-case spelling; the first is the default
    units: Mapping[str, Unit]
    needs: str = ""  # phrases, one of which it must contain as well; empty for none
    better: str = ""  # phrases that speak for a name
    worse: str = ""  # phrases that speak against it if there is another
    never: str = ""  # phrases that exclude a name


@cache
def _phrases(text: str) -> tuple[str, ...]:
    return tuple(phrase.strip() for phrase in text.split(",") if phrase.strip())


def _units(**factors: float) -> dict[str, Unit]:
    return {name: Unit(factor) for name, factor in factors.items()}


_KMH, _MPH, _KNOT = Unit(1 / 3.6), Unit(0.44704), Unit(1852 / 3600)
_SPEED = dict.fromkeys(("m/s", "mps", "ms", "m/sec", "meter/sec", "meters/sec"), Unit(1.0))
_SPEED |= dict.fromkeys(("meter/second", "meters/second", "metres/second"), Unit(1.0))
_SPEED |= dict.fromkeys(("km/h", "kmh", "kph", "kmph", "km/hr", "km/t", "km/hour"), _KMH)
_SPEED |= dict.fromkeys(("kilometers/hour", "kilometres/hour"), _KMH)
_SPEED |= dict.fromkeys(("mph", "mi/h", "mi/hr", "miles/hour"), _MPH)
_SPEED |= dict.fromkeys(("kn", "kt", "kts", "knots"), _KNOT)
_TIME = _units(s=1.0, sec=1.0, secs=1.0, second=1.0, seconds=1.0, ms=1e-3, msec=1e-3, us=1e-6)
_TIME |= _units(µs=1e-6, ns=1e-9, milliseconds=1e-3, millis=1e-3, microseconds=1e-6)
_TIME |= _units(nanoseconds=1e-9, min=60.0, mins=60.0, minute=60.0, minutes=60.0)
_TIME |= _units(h=3600.0, hr=3600.0, hrs=3600.0, hour=3600.0, hours=3600.0, days=86400.0)
_POWER = _units(w=1.0, kw=1e3, watts=1.0, kilowatts=1e3)
_CELSIUS, _FAHRENHEIT = Unit(1.0), Unit(5 / 9, -160 / 9)
_TEMPERATURE = dict.fromkeys(("c", "°c", "℃", "degc", "deg c", "celsius"), _CELSIUS)
_TEMPERATURE |= dict.fromkeys(("f", "°f", "℉", "degf", "deg f", "fahrenheit"), _FAHRENHEIT)
_TEMPERATURE |= dict.fromkeys(("k", "kelvin", "degk"), Unit(1.0, -273.15))
_LENGTH = _units(m=1.0, meters=1.0, ft=0.3048, feet=0.3048)
_DISTANCE = _units(km=1e3, kilometers=1e3, mi=1609.344, miles=1609.344, m=1.0)
_DEGREES = {"deg": Unit(1.0), "°": Unit(1.0), "degrees": Unit(1.0), "rad": Unit(180.0 / math.pi)}
_PERCENT = {
    "%": Unit(1.0),
    "per": Unit(1.0),
    "pct": Unit(1.0),
    "percent": Unit(1.0),
    "fraction": Unit(100.0),
}
_GRADE = {text: Unit(0.01 * unit.factor) for text, unit in _PERCENT.items()}
_GRADE |= {text: Unit(math.radians(unit.factor)) for text, unit in _DEGREES.items()}

_BATTERY = (
    "battery,batt,bat,pack,hv,ht,traction,dc,total,v b,batterie,batteri,batterij,batería,batteria,"
    "bateria,baterii,baterie"
)
_OTHERS = (
    "motor,engine,cell,min,max,limit,charger,aux,auxiliary,lv,12v,phase,target,set,heating,heater,"
    "htr,aircon,ac,a c,regen,available,fan,accuracy,acc,wind,rear,gps2,temp,temperature,module,"
    "dc dc,12 v,24v,24 v,starter,ignition,ecu,low voltage,rms,error,offset,previous,prev,"
    "reference,ref,desired,demand,commanded,request,requested,setpoint,std,deviation,ripple,insulation,"
    "adapter,avg,average,mean,moyenne,media,durchschnittlich,zelle,cella,celda,cellule,obc,dcdc,evse,steering,sensor,throttle"
)
_NO_PLACE = "accuracy,error,acceleration,accel,acc,g,force,rate,term,trim,fuel,speed,time"
# Words for a voltage that the app computed from the measured one, or that of a battery at rest.
_COMPUTED = "corrected,compensated,open circuit,ocv,estimated,filtered,smoothed,nominal,simulated"
# Words for energy that braking returns, and all opposites of those for drawn energy.
BRAKED = (
    *("regen", "regenerated", "regenerative", "regeneration", "recuperation", "recuperated"),
    "returned",
)
BACK = (*BRAKED, "charge", "charging", "charged", "in", "input")
_CHARGED = "," + ",".join(BACK)
_NO_POWER = "temperature,temp,current,voltage,signal,request,coolant,inlet,outlet,comp"

QUANTITIES: Mapping[str, ColumnQuantity] = {
    "time": ColumnQuantity(
        "t_s",
        "t,time,timestamp,datetime,date,zeit,datum,uhrzeit,seconds,secs,minutes,hours,elapsed,"
        "milliseconds,millis,stamp,utc,epoch,ms today,"
        "zeitstempel,temps,heure,horodatage,tiempo,fecha,hora,tempo,tijd,tid,czas,čas,время,"
        "时间,数据时间,采集时间,時刻,日時,시간",
        _TIME,
        better="time,timestamp,elapsed,epoch,phase",
        worse="since,trip",
        never="charging,remaining,left,to full,charge,max,min,parking,watt,watts,wh,kwh,amp,amps,"
        "ampere,ah,energy",
    ),
    "speed": ColumnQuantity(
        "speed_mps",
        "speed,velocity,spd,geschwindigkeit,fahrzeuggeschwindigkeit,vehiclespeed,kmh,kph,mph,mps,"
        "vitesse,velocidad,velocità,velocidade,snelheid,hastighet,hastighed,prędkość,rychlost,"
        "скорость,车速,車速,차속,v veh,vveh",
        _SPEED,
        better="vehicle,car,obd,v p",
        worse="gps,gnss,ground",
        never=_OTHERS + ",wheel,shaft,rpm,angular,air,schedule",
    ),
    "voltage": ColumnQuantity(
        "voltage_v",
        "voltage,volt,volts,spannung,tension,tensión,tensione,tensão,spanning,spænding,spänning,"
        "spenning,napięcie,napětí,напряжение,总电压,电压,電圧,전압,"
        "u bat,u batt,ubat,ubatt,v bat,v batt,vbat,vbatt",
        _units(v=1.0, volts=1.0, mv=1e-3),
        better=_BATTERY,
        worse=_COMPUTED,
        never=_OTHERS + ",12,control",
    ),
    "current": ColumnQuantity(
        "current_a",
        "current,curr,amps,ampere,amperage,strom,courant,corriente,corrente,stroom,ström,strøm,"
        "prąd,proud,ток,总电流,电流,電流,전류,i bat,i batt,ibat,ibatt",
        _units(a=1.0, amps=1.0, ma=1e-3),
        better=_BATTERY,
        worse=_COMPUTED + _CHARGED,
        never=_OTHERS,
    ),
    "power": ColumnQuantity(
        "power_w",
        "power,pwr,kw,leistung,puissance,potencia,potenza,potência,vermogen,"
        "effekt,moc,výkon,мощность,功率,電力,전력",
        _POWER,
        better=_BATTERY,
        worse=_COMPUTED + _CHARGED,
        never=_OTHERS + ",sw",
    ),
    "elevation": ColumnQuantity(
        "elevation_m",
        "elevation,altitude,alt,elv,height,höhe,altitud,altitudine,quota,hoogte,höjd,høyde,"
        "wysokość,výška,высота,海拔,高度,標高,고도",
        _LENGTH,
        better="v p",
        never="accuracy,error",
    ),
    "grade": ColumnQuantity(
        "grade_fraction",
        "grade,gradient,slope,incline,inclination,steepness,steigung,pente,pendiente,pendenza",
        _GRADE,
        better="road",
        never=_OTHERS + ",battery,accuracy,fuel,id,time,speed,elevation,length",
    ),
    "latitude": ColumnQuantity("latitude", "latitude,lat", _DEGREES, never=_NO_PLACE),
    "longitude": ColumnQuantity("longitude", "longitude,long,lon,lng", _DEGREES, never=_NO_PLACE),
    "ambient": ColumnQuantity(
        "ambient_c",
        "ambient,outside,outdoor,ext temp,außentemperatur,aussentemperatur,v e temp,temp amb,oat,"
        "extérieure,exterieure,exterior,ambiente,esterna,buiten,buitentemperatuur,utetemperatur,udetemperatur,"
        "zewnętrzna,venkovní,环境温度,外気温",
        _TEMPERATURE,
        better="temperature,temp,air",
        never="pressure,humidity,light",
    ),
    "heating": ColumnQuantity(
        "heating_w",
        "heating,heater,htr,heizung",
        _POWER,
        needs="power,pwr,leistung,w,kw",
        worse="est",
        never="can,no,on," + _NO_POWER,
    ),
    "aircon": ColumnQuantity(
        "aircon_w",
        "aircon,airconditioning,air conditioning,a c,ac,climate",
        _POWER,
        needs="power,pwr,leistung,w,kw",
        worse="est",
        never="charger,motor,charge,heater,heating,htr," + _NO_POWER,
    ),
    "charge": ColumnQuantity(
        "soc_pct",
        "soc,stateofcharge,state of charge,battery level,charge pct,charge percent,charge level,"
        "battery pct,battery percent,battery percentage,ladezustand,état de charge,"
        "estado de carga,stato di carica,laadtoestand,stan naładowania,stav nabití,荷电状态",
        _PERCENT,
        better="battery,displayed,display,hv",
        worse="usable",
        never="min,max,target,limit,health,cell,12v,12 v,24v,24 v,lv,aux,auxiliary,starter,error",
    ),
    "motor_torque": ColumnQuantity(
        "motor_torque_nm",
        "motor torque,motortorque,inverter torque",
        _units(nm=1.0),
        never="request,requested,target,limit,max,min",
    ),
    "motor_speed": ColumnQuantity(
        "motor_speed_rad_s",
        "motor speed,motorspeed,motor rpm",
        {"rad/s": Unit(1.0), "rpm": Unit(math.pi / 30), "1/min": Unit(math.pi / 30)},
        never="request,requested,target,limit,max,min,vehicle",
    ),
    "odometer": ColumnQuantity(
        "odometer_km",
        "odo,odometer,kilometerstand,v p odometer,累计里程",
        _DISTANCE,
        never="temperature,since",
    ),
}
_ENGINE = "engine speed,engine rpm,ice rpm,ice speed,régime moteur,verbrenner drehzahl"
PLACES = ("latitude", "longitude")
NEEDED = frozenset(("time", "speed", "voltage", "current", "power"))  # needed, or most of these
BY_COLUMN = {quantity.column: name for name, quantity in QUANTITIES.items()}
ANGLES = frozenset(_DEGREES)  # units of a grade given as an angle
ONE_WORD = ("speed", "power")  # quantities that a unit alone can name
WORSE = 100.0  # penalty of a name with a worse phrase
SHORTEST_SPELLED = 3  # letters of a unit that may occur anywhere in a name
_SPELLED = ("seconds", "minutes", "hours", "milliseconds", "millis")
# Words in brackets after a name that are no unit, but the source of the number.
QUALIFIERS = _phrases("obd,gps,can,ecu,raw,hv,ev,bms,outside,since journey start,real")


@lru_cache(maxsize=4096)
def words_of(name: str) -> tuple[str, tuple[str, ...]]:
    """Words outside and inside brackets, lower case; a bracket at the start is a control unit."""
    rest = re.sub(r"^\s*\[[^\]]*\]", "", name)
    brackets = [text for text, end in re.findall(r"[\[(]([^\])]*)([\])]?)", rest) if end]
    bare = re.sub(r"[\[(][^\])]*[\])]?", " ", rest)
    bare = bare.replace("_", " ")
    # Do not split kW, mV and SoC; do split vehicleSpeed and HVBatt.
    bare = re.sub(r"(?<=[a-z])(?<!\bk)(?<!\bm)(?<!\bSo)(?=[A-Z])", " ", bare)
    bare = re.sub(r"(?<=[A-Z])(?=[A-Z][a-z])", " ", bare)
    # Split batteriespannung and batteristrøm too.
    bare = re.sub(r"\b(battery|batterie|batterij|batteri)(?=\w{5})", r"\1 ", bare.lower())
    words = re.findall(r"[^\W_]+", bare)
    return f" {' '.join(words)} ", tuple(text.strip().lower() for text in brackets)


@lru_cache(maxsize=65536)
def score(quantity: str, name: str) -> float:
    """Score of a name for a quantity; 0 if it does not match."""
    meanings = QUANTITIES[quantity]
    words, brackets = words_of(name)
    # A bracket before the unit, as in `Voltage (OBD Adapter)(V)`, is part of the name.
    for text in brackets[:-1]:
        words += f"{text} "

    def has(phrases: str) -> int:
        return sum(f" {phrase} " in words for phrase in _phrases(phrases))

    spelled = words if not brackets else f"{words}{re.sub(r'[^a-z]', '', brackets[-1])} "
    needed = not meanings.needs or any(
        f" {phrase} " in spelled for phrase in _phrases(meanings.needs)
    )
    if not has(meanings.words) or has(meanings.never) or not needed:
        return 0.0
    better = 1.0 + has(meanings.better)
    return better if not has(meanings.worse) else better / WORSE


def speaks_of(quantity: str, name: str) -> bool:
    """True if a name contains a word of the quantity, for any part of the car."""
    words, _ = words_of(name)
    return any(f" {phrase} " in words for phrase in _phrases(QUANTITIES[quantity].words))


def is_engine_speed(name: str) -> bool:
    """True if a name is the speed of a combustion engine."""
    words, _ = words_of(name)
    return any(f" {phrase} " in words for phrase in _phrases(_ENGINE))


def may_be_of_use(name: str) -> bool:
    """True if a signal with this name may be a quantity other than time."""
    return any(score(quantity, name) > 0 for quantity in QUANTITIES if quantity != "time")


def unit_of(quantity: str, name: str) -> tuple[str, Unit | None]:
    """Spelling and unit in a name; (text, None) if it is unknown, ("", None) if there is none."""
    units = QUANTITIES[quantity].units
    words, brackets = words_of(name)
    if brackets and (unit := known_unit(quantity, brackets[-1])):
        return brackets[-1], unit
    parts = words.replace(" per ", "/").split()
    for text in ("/".join(parts[-2:]), parts[-1] if parts else ""):
        # A single word is a name, not a unit: "t" is no ton, "h" no hour.
        if len(parts) > 1 and text in units:
            return text, units[text]
        if len(parts) == 1 and text in units and (quantity in ONE_WORD or text in _SPELLED):
            return text, units[text]
    if len(parts) > 1 and quantity in NEEDED - {"time"}:
        anywhere = [*parts, *map("/".join, pairwise(parts))]
        spelled = {text for text in anywhere if len(text) >= SHORTEST_SPELLED and text in units}
        if len({units[text] for text in spelled}) == 1:
            return (text := min(spelled)), units[text]
    unknown = brackets and brackets[-1] and brackets[-1] not in QUALIFIERS
    return (brackets[-1], None) if unknown else ("", None)


def known_unit(quantity: str, text: str) -> Unit | None:
    """The unit with this spelling; `250w` is 250 of the unit w."""
    units = QUANTITIES[quantity].units
    if text in units:
        return units[text]
    multiple = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([^\d\s]\D*)", text)
    if multiple is None or multiple[2] not in units or units[multiple[2]].offset:
        return None
    factor = float(multiple[1])
    return Unit(factor * units[multiple[2]].factor) if factor > 0 else None
