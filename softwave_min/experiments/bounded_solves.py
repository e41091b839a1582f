"""Solves with few iterations, for sets that may lie far from the nominal one."""

from __future__ import annotations

from dataclasses import replace

from softwave_min.parameters import Count, ParameterSet, data_folder, read_toml, validate

__all__ = ["with_bounded_solves"]


def with_bounded_solves(parameters: ParameterSet) -> ParameterSet:
    """The parameters with no more iterations than data/parameters/bounded_solves.toml allows."""
    path = data_folder() / "parameters" / "bounded_solves.toml"
    most = validate(dict[str, Count], read_toml(path), source=path)["iterations"]
    nmpc = parameters.nmpc
    return replace(parameters, nmpc=replace(nmpc, max_iterations=min(most, nmpc.max_iterations)))
