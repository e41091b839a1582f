r"""What the controller is told of the coming sea.

The paper gives the controller the loads of its own disturbance model 'with added
white Gaussian noise (SNR = 20)'. Here a forecast is the flow of every coming
control period, exactly as the plant will meet it, and a noise added to the
generalised load that the predictor makes of it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from softwave_min.parameters import PreviewParameters

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Forecast:
    """Flow and load noise of the control periods to come."""

    flow: Floats
    """(K, F), packed coefficients of the flow, one row per period."""
    disturbance: Floats
    """(K, n), error of the generalised load, in N m."""


def noise_deviation(parameters: PreviewParameters, signal: Floats) -> Floats:
    """Standard deviation of the noise on each generalised load, (n,) in N m.

    Parameters
    ----------
    parameters : PreviewParameters
    signal : array, (T, n)
        The loads that the ratio refers to, in N m.
    """
    level: Floats = np.sqrt(np.mean(signal**2, axis=0))
    match parameters.noise:
        case "none":
            return np.zeros_like(level)
        case "decibel":
            return level * 10 ** (-parameters.signal_to_noise / 20)
        case "ratio":
            return level / float(np.sqrt(parameters.signal_to_noise))


def forecast_flow(parameters: PreviewParameters, flow: Floats) -> Floats:
    """The flow as the controller is told it, (T, F): late, biased, or still water."""
    if not parameters.waves:
        return np.zeros_like(flow)
    late = np.maximum(np.arange(len(flow)) - parameters.delay_periods, 0)
    forecast: Floats = (1 + parameters.bias) * flow[late]
    return forecast


class Preview:
    """Forecasts of one run.

    Parameters
    ----------
    flow : array, (steps + K, F)
        Packed flow of every control period: the very rows that the plant uses.
    deviation : array, (n,)
        Standard deviation of the noise, in N m.
    horizon : int
        Periods in a forecast, K.
    parameters : PreviewParameters
    """

    def __init__(
        self, flow: Floats, deviation: Floats, horizon: int, parameters: PreviewParameters
    ) -> None:
        self.flow = forecast_flow(parameters, flow)
        """The flow as it is told, one row per period."""
        self._deviation = deviation
        self._horizon = horizon
        self._redrawn = parameters.redrawn
        self._generator = np.random.default_rng(parameters.seed)
        self._frozen = self._draw(len(flow))

    def at(self, step: int) -> Forecast:
        """Forecast at the start of period ``step``; its row j speaks of period step + j."""
        window = slice(step, step + self._horizon)
        disturbance = self._draw(self._horizon) if self._redrawn else self._frozen[window]
        return Forecast(self.flow[window], disturbance)

    def disturbances(self, steps: int) -> Floats:
        """Load noise of the first ``steps`` forecasts, in their order, (steps, K, n) in N m."""
        return np.array([self.at(step).disturbance for step in range(steps)])

    def _draw(self, rows: int) -> Floats:
        return self._deviation * self._generator.standard_normal((rows, len(self._deviation)))
