"""The table of coupling terms, found in the modules of `ga.model.effects`, and the names of models.

The table is ordered by role. Within a role, common terms come before rare terms; terms that are equal in this have the
order of their modules, and of their lines in a module.
"""

from __future__ import annotations

import difflib
from dataclasses import replace
from importlib import import_module
from pkgutil import iter_modules
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from ga.model import effects
from ga.model.record import ROLES, Kind, Parameter, Role, Term

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping

_CLASSES: Final = ("smallest", "considered", "motor torque", "misfit", "named")

_modules: Final = (import_module(f"{effects.__name__}.{one.name}") for one in iter_modules(effects.__path__))
_stated: Final = {id(one): one for module in _modules for one in vars(module).values() if isinstance(one, Term)}
_RECORDS: Final = sorted(_stated.values(), key=lambda one: (ROLES.index(one.role), _CLASSES.index(one.selection)))

_terms: Final = {term.name: term for term in _RECORDS}
_parameters: Final = {p.name: p for t in _RECORDS for p in t.parameters}

TERMS: Final[Mapping[str, Term]] = MappingProxyType(_terms)
"""Every term by its name, in the order in which a model's name lists them."""

PARAMETERS: Final[Mapping[str, Parameter]] = MappingProxyType(_parameters)
"""Every parameter by its name."""

CONSIDERED: Final = tuple(
    t.name for t in _RECORDS if t.selection in {"smallest", "considered"} and t.role != "coupling"
)
"""The common terms, and those of the smallest model."""

SMALLEST: Final = "+".join(t.name for t in _RECORDS if t.selection == "smallest")
"""The name of the smallest model that is selected."""


def of_role(*roles: Role) -> tuple[str, ...]:
    """Return the names of the terms of the given roles, in the order of the table, without terms of the class
    "named".
    """
    return tuple(name for name, one in TERMS.items() if one.role in roles and one.selection != "named")


def of_kind(names: Iterable[str], *kinds: Kind) -> tuple[str, ...]:
    """Return the entries of `names` that name a parameter of one of the given kinds, in their order."""
    return tuple(name for name in names if name in PARAMETERS and PARAMETERS[name].kind in kinds)


def size_of(values: Mapping[str, float], *kinds: Kind) -> float:
    """Return the sum of all parameters of the given kinds; 0 without any. values: the parameters by name."""
    return sum((values[name] for name in of_kind(values, *kinds)), 0.0)


class UnknownTerm(ValueError):
    """The error that a model names an unknown term; the message lists the known ones."""


def add(term: Term) -> None:
    """Add a term of another package to the table: a model can then name the term, but model selection does not consider
    it.

    Raises ValueError if a term or a parameter with its name exists already.
    """
    if TERMS.get(term.name) == (named := replace(term, selection="named")):
        return
    names = {parameter.name for parameter in term.parameters}
    if term.name in TERMS or names.intersection(PARAMETERS):
        raise ValueError(
            f"a term or a parameter with the name {term.name} or {', '.join(sorted(names))} exists already"
        )
    _terms[term.name] = named
    _parameters.update({parameter.name: parameter for parameter in term.parameters})


def canonical(name: str) -> str:
    """Return the name of a model, such as "linear+offset+coulomb", with its terms in the order of the table.

    Raises UnknownTerm for an unknown term, ValueError for a term named twice, a missing `linear`, or two terms that
    exclude each other.
    """
    names = [term.strip() for term in name.split("+")]
    for term in names:
        if term not in TERMS:
            near = difflib.get_close_matches(term, TERMS, n=1)
            hint = f' did you mean "{near[0]}"?' if near else ""
            raise UnknownTerm(f'no model term "{term}":{hint} there are {", ".join(TERMS)}')
        if names.count(term) > 1:
            raise ValueError(f'model "{name}": {term} is named twice')
        if set(TERMS[term].excludes).intersection(names):
            raise ValueError(f'model "{name}": {TERMS[term].reason}: leave one out')
    if "linear" not in names:
        raise ValueError(f'model "{name}": every model begins with linear, as in "linear+{name}"')
    return "+".join(term for term in TERMS if term in names)


def is_addable(term: str, terms: Collection[str]) -> bool:
    """Return whether a term can be added to a model of these terms.

    It cannot if the model has the term already, has a term that excludes it, or lacks a term that it needs.
    """
    return term not in terms and not lacking(term, terms) and not any(_excluded(term, other) for other in terms)


def lacking(term: str, terms: Collection[str]) -> str:
    """Return the term that this term needs and that is missing in `terms`; empty if no term is missing."""
    needs = TERMS[term].needs
    return "" if not needs or {needs, *TERMS[term].or_needs}.intersection(terms) else needs


def compatible_model(term: str, terms: Collection[str]) -> str:
    """Return the name of a model with `term`, the term that it needs, and all of `terms` that these two do not
    exclude.
    """
    needed = lacking(term, terms) or term
    others = _beside((needed, term), terms)
    return canonical("+".join(dict.fromkeys(("linear", *others, needed, term))))


def _beside(given: Collection[str], terms: Collection[str]) -> tuple[str, ...]:
    """Return the terms in `terms` that the `given` terms do not exclude, and whose needed terms they do not exclude."""
    kept = tuple(term for term in terms if not any(_excluded(one, term) for one in given))
    lost = [term for term in kept if lacking(term, (*kept, *given)) and not lacking(term, terms)]
    return tuple(term for term in kept if term not in lost)


def _excluded(one: str, other: str) -> bool:
    return other in TERMS[one].excludes or one in TERMS[other].excludes
