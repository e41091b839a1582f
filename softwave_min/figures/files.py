"""Draw an experiment's figures into its folder, in whichever process."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from softwave_min.data import recording
from softwave_min.parameters import ParameterSet
from softwave_min.runs.identity import Identity, file_digests
from softwave_min.runs.plan import figures_identity
from softwave_min.runs.store import Store, write_atomically

if TYPE_CHECKING:
    from softwave_min.figures.style import Drawing


def draw_files(store: Store, parameters: ParameterSet) -> None:
    """Draw the figures of the tables that are there, and write them with what they came from."""
    # Imported here: who has the figures drawn elsewhere needs no matplotlib.
    import matplotlib.pyplot as plt  # noqa: PLC0415

    from softwave_min.figures import style  # noqa: PLC0415

    style.apply()
    module = import_module(f"softwave_min.figures.{store.experiment}")
    try:
        with recording() as read:
            drawings: dict[str, Drawing] = module.draw(store, parameters)
        for stem, drawing in drawings.items():
            write_atomically(store.folder / f"{stem}.svg", style.svg(drawing))
            for suffix, film in drawing.media.items():
                write_atomically(store.folder / f"{stem}.{suffix}", film)
    finally:
        plt.close("all")  # a worker draws for many experiments
    record = store.provenance()
    tables = record.get("identity", {}).get("tables", {})
    # What identifies the tables identifies the runs, whose files are on no other machine.
    files = file_digests((path for path in read if path.suffix != ".npz"), store.root)
    figures = figures_identity(store.experiment, Identity(tables).digest, files, store.root)
    store.write_provenance(
        {
            **record,
            "identity": {"tables": tables, "figures": figures.parts},
            "figures": {
                stem: {"caption": drawing.caption, "alt": drawing.alt}
                for stem, drawing in drawings.items()
            },
            "files": store.file_digests(),
        }
    )
