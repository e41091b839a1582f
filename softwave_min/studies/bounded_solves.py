"""Solves with few iterations, for sets that may lie far from the nominal one."""

from __future__ import annotations

from dataclasses import replace

from softwave_min.parameters import Count, ParameterSet, load_data


def with_bounded_solves(parameters: ParameterSet) -> ParameterSet:
    """The parameters with no more iterations than data/studies/bounded_solves.toml allows."""
    most = load_data(dict[str, Count], "studies/bounded_solves.toml")["iterations"]
    nmpc = parameters.nmpc
    return replace(parameters, nmpc=replace(nmpc, max_iterations=min(most, nmpc.max_iterations)))
