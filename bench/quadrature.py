"""How inertia, weight, load and path of the tip change with the Gauss points per segment.

Against 16 points: the largest change of M and G over random postures and of the water's load
over random states in the sea, each relative to the largest entry, and the largest distance
between the tip's paths over one minute of the baseline's loop.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from softwave_min.data import data_folder
from softwave_min.parameters import ParameterSet, load_parameters
from softwave_min.simulation import BaselineController, Scenario, simulate
from softwave_min.waves import Sea

Floats = NDArray[np.float64]

P3 = (0.7, -3.7)
FINEST = 16
STATES = 200


@dataclass(frozen=True)
class Quantities:
    """What is compared."""

    inertia: Floats
    gravity: Floats
    load: Floats
    path: Floats


def quantities(parameters: ParameterSet, points: int) -> Quantities:
    """The quantities with a number of points on each segment."""
    arm = replace(parameters.arm, quadrature_points=points)
    parameters = replace(parameters, arm=arm)
    sea = Sea.random(parameters.sea, parameters.fluid.gravity)
    scenario = Scenario.build(parameters, sea, P3)
    model = scenario.arm
    q, qd = np.random.default_rng(1).uniform(-1.5, 1.5, (2, STATES, model.segments))
    return Quantities(
        model.body_inertia(q) + model.added_inertia(q),
        model.gravity_vector(q),
        model.fluid_load(q, qd, scenario.flow[:STATES]),
        simulate(scenario, BaselineController(scenario)).tips[:, -1],
    )


def study(parameters: ParameterSet) -> Iterator[tuple[int, Quantities]]:
    """Changes against the finest rule."""
    finest = quantities(parameters, FINEST)
    for points in range(2, 13):
        found = quantities(parameters, points)
        yield (
            points,
            Quantities(
                relative(found.inertia, finest.inertia),
                relative(found.gravity, finest.gravity),
                relative(found.load, finest.load),
                np.max(np.hypot(*(found.path - finest.path).T)),
            ),
        )


def relative(found: Floats, finest: Floats) -> Floats:
    """Largest change relative to the largest entry."""
    change: Floats = np.max(np.abs(found - finest)) / np.max(np.abs(finest))
    return change


def main() -> None:
    """Print the table for the nominal arm and sea."""
    parameters = load_parameters(data_folder() / "parameters" / "physical.toml")
    # CVODES: the compiled plant would be compiled anew for every number of points.
    simulation = replace(parameters.simulation, integrator="cvodes")
    print(f"{'points':>6} {'inertia':>9} {'gravity':>9} {'load':>9} {'tip, m':>9}")
    for points, change in study(replace(parameters, simulation=simulation)):
        print(
            f"{points:6} {change.inertia:9.1e} {change.gravity:9.1e}"
            f" {change.load:9.1e} {change.path:9.1e}",
            flush=True,
        )


if __name__ == "__main__":
    main()
