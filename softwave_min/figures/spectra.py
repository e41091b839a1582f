"""The paper's Fig. spectra: JONSWAP curves and 60 s records of the three seas."""

from __future__ import annotations

import matplotlib.pyplot as plt

from softwave_min.experiments.spectra import EXPERIMENT, SeaRecord
from softwave_min.figures.style import DASHES, SERIES, Drawing
from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store

CURVE_SHOWN_HZ = 0.4


def draw(store: Store, parameters: ParameterSet) -> dict[str, Drawing]:
    """Draw ``spectra``: (a) the three curves, (b) to (d) one record of each."""
    runs = EXPERIMENT.runs(parameters)
    records: list[SeaRecord] = [run.parameters for run in runs]
    results = [store.load_run(run) for run in runs]
    height, window = records[0].sea.significant_height, records[0].window
    reach = max(float(abs(result["elevation"]).max()) for result in results)
    figure, panels = plt.subplots(2, 2, figsize=(7.0, 4.4))
    curves, *series = panels.ravel()
    looks = zip(series, "bcd", SERIES, DASHES, strict=True)
    for record, result, (axes, letter, color, dashes) in zip(records, results, looks, strict=True):
        shown = result["frequency_hz"] <= CURVE_SHOWN_HZ
        frequency, density = result["frequency_hz"][shown], result["density"][shown]
        curves.plot(frequency, density, color=color, linestyle=dashes)
        peak, beside = density.argmax(), {"xytext": (6, 0), "textcoords": "offset points"}
        curves.annotate(record.case.name, (frequency[peak], density[peak]), va="center", **beside)
        axes.plot(result["time"], result["elevation"], color=color, linestyle="-")
        axes.set_title(f"({letter}) {record.case.name}, $T_p$ = {record.sea.peak_period:g} s")
        axes.set(xlabel="time (s)", ylabel="elevation (m)")
        axes.set(xlim=(0, window), ylim=(-1.1 * reach, 1.1 * reach))
    curves.set(title=f"(a) JONSWAP, $H_s$ = {height:g} m", xlim=(0, CURVE_SHOWN_HZ))
    curves.set(xlabel="frequency (Hz)", ylabel="density (m²/Hz)")
    curves.set_ylim(bottom=0)
    periods = ", ".join(f"{r.sea.peak_period:g} s ({r.case.name})" for r in records)
    caption = (
        f"The three seas of the paper at a significant height of {height:g} m. (a) JONSWAP"
        f" curves with peak enhancement {records[0].sea.peak_enhancement:g}; (b) to (d) surface"
        f" elevation above the base of the arm over {window:g} s. The three records share their"
        " random phases."
    )
    alt = (
        f"Four panels. First: three spectral curves with peak periods {periods}; the longer the"
        " period, the lower the frequency of the peak and the higher the curve. The others:"
        f" elevation against time over {window:g} s, irregular waves up to {reach:.1f} m above"
        " and below the mean level, quicker in W1 than in W3."
    )
    return {"spectra": Drawing(figure, caption, alt)}
