"""What the paper leaves open: how it can be read, and how it is read here.

``data/paper/open_points.toml`` has one entry for each point. Where a parameter decides between
the readings the entry names it with the values that select the others, so that
:meth:`Switch.alternatives` are the parameter sets with which the effect can be measured.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass as validated

from softwave_min.data import ParameterError, data_folder, read_toml
from softwave_min.parameters import ParameterSet, parameter_set, validate

Text = Annotated[str, Field(min_length=1)]
FieldName = Annotated[str, Field(pattern=r"^\w+\.\w+$")]
Kind = Literal["slip", "gap", "wording", "argument"]

_FROZEN = ConfigDict(extra="forbid")


@validated(frozen=True, config=_FROZEN)
class Switch:
    """A parameter that selects other readings."""

    field: FieldName
    """Section and name in the parameter set."""
    values: Annotated[tuple[Any, ...], Field(min_length=1)]
    """Those of the other readings, or the ends of what is plausible."""
    along: dict[FieldName, tuple[Any, ...]] = Field(default_factory=dict)
    """Fields that have to change with it, with an entry for each of the values."""

    @model_validator(mode="after")
    def _one_entry_per_value(self) -> Self:
        if any(len(entries) != len(self.values) for entries in self.along.values()):
            raise ValueError(f"{len(self.values)} entries in each of along, one per value")
        return self

    def alternatives(self, parameters: ParameterSet) -> tuple[ParameterSet, ...]:
        """One parameter set for each of the values.

        Raises
        ------
        ParameterError
            If there is no such field, it cannot have a value, or has it already.
        """
        found = tuple(self.applied(place, parameters) for place in range(len(self.values)))
        for value, other in zip(self.values, found, strict=True):
            if other == parameters:
                raise ParameterError(f"switch: {self.field} is {value!r} already")
        return found

    def applied(self, place: int, parameters: ParameterSet) -> ParameterSet:
        """The parameters with the value at a place of the list.

        Raises
        ------
        ParameterError
            If there is no such field, or it cannot have that value.
        """
        entries = asdict(parameters)
        changed = {self.field: self.values, **self.along}
        for name, values in changed.items():
            section, own = name.split(".")
            entries.setdefault(section, {})[own] = values[place]
        return validate(ParameterSet, entries, source="switch")


@validated(frozen=True, config=_FROZEN)
class OpenPoint:
    """A place of the paper that can be read in more than one way, or that seems to slip."""

    id: Annotated[str, Field(pattern=r"^A\d\d$")]
    kind: Kind
    """'slip': what is printed contradicts itself or the physics. 'gap': something is not
    stated. 'wording': the words have several meanings. 'argument': a conclusion that the
    numbers may not carry."""
    place: Text
    """Where in the paper."""
    says: Text
    """What it says, or leaves open, in our words."""
    readings: Annotated[tuple[Text, ...], Field(min_length=2)]
    choice: Annotated[int, Field(ge=1)]
    """Number of the reading that is taken here, from 1."""
    reason: Text
    """Why that one."""
    page: Text
    """Page of the book that treats it."""
    label: str = ""
    """Of the section, figure or table there."""
    switches: tuple[Switch, ...] = ()
    """Parameters that select the other readings."""
    elsewhere: str = ""
    """Where the other readings are found if not by a parameter."""

    @model_validator(mode="after")
    def _chooses_one(self) -> Self:
        if self.choice > len(self.readings):
            raise ValueError(f"choice at most {len(self.readings)}, the number of readings")
        return self


def open_points(parameters: ParameterSet | None = None) -> tuple[OpenPoint, ...]:
    """The open points, in the order of their ids.

    Parameters
    ----------
    parameters
        The set that the switches are tried on; the default one if none is given.

    Raises
    ------
    ParameterError
        If the file is not valid, an id stands there twice, or a switch selects nothing.
    """
    path = data_folder() / "paper" / "open_points.toml"
    found = validate(dict[str, tuple[OpenPoint, ...]], read_toml(path), source=path)["point"]
    twice = [name for name, count in Counter(one.id for one in found).items() if count > 1]
    if twice:
        raise ParameterError(f"{path}: twice: {', '.join(twice)}")
    nominal = parameters or parameter_set()
    for point in found:
        for switch in point.switches:
            try:
                switch.alternatives(nominal)
            except ParameterError as error:
                raise ParameterError(f"{path}: {point.id}: {error}") from None
    return tuple(sorted(found, key=lambda one: one.id))
