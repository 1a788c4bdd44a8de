from evpinn_ros.api import EdgeEnergies as EdgeEnergies
from evpinn_ros.api import Estimate as Estimate
from evpinn_ros.api import Estimator as Estimator
from evpinn_ros.api import InputError as InputError
from evpinn_ros.api import Result as Result
from evpinn_ros.api import Vehicle as Vehicle
from evpinn_ros.api import edge_energies as edge_energies
from evpinn_ros.api import find_vehicles as find_vehicles
from evpinn_ros.api import forecast as forecast
from evpinn_ros.api import load_vehicle as load_vehicle
from evpinn_ros.api import replay as replay
from evpinn_ros.api import replay_trips as replay_trips

__version__: str
