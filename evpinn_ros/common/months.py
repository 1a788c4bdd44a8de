"""Months as programs abbreviate them, in the languages of their users."""

from __future__ import annotations

_NAMES = (
    ("Jan", "jan jän janv ene gen янв"),
    ("Feb", "feb févr fév fev fevr лют фев"),
    ("Mar", "mar mär märz mrz mars mrt мар"),
    ("Apr", "apr avr abr апр"),
    ("May", "may mai mag mei maj мая май"),
    ("Jun", "jun juin giu июн"),
    ("Jul", "jul juil lug июл"),
    ("Aug", "aug août aoû ago авг"),
    ("Sep", "sep sept set сен"),
    ("Oct", "oct okt ott out окт"),
    ("Nov", "nov ноя"),
    ("Dec", "dec déc dez dic дек"),
)
MONTHS = {name: number for number, (_, names) in enumerate(_NAMES, 1) for name in names.split()}
"""Number of a month by its abbreviation in lower case."""

IN_ENGLISH = {name: english for english, names in _NAMES for name in names.split()}
"""English abbreviation of a month by its abbreviation in any language."""
