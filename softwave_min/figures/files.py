"""Draw an experiment's figures into its folder, in whichever process."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from softwave_min.parameters import ParameterSet
from softwave_min.runs.store import Store, write_atomically
from softwave_min.runs.sweep import file_digests

if TYPE_CHECKING:
    from softwave_min.figures.style import Drawing


def draw_files(store: Store, parameters: ParameterSet, identity: str) -> None:
    """Draw and write the figures; ``identity`` is what determines them."""
    # Imported here: who has the figures drawn elsewhere needs no matplotlib.
    from softwave_min.figures import style  # noqa: PLC0415

    style.apply()
    module = import_module(f"softwave_min.figures.{store.experiment}")
    drawings: dict[str, Drawing] = module.draw(store, parameters)
    for stem, drawing in drawings.items():
        write_atomically(store.folder / f"{stem}.svg", style.svg(drawing))
        for suffix, film in drawing.media.items():
            write_atomically(store.folder / f"{stem}.{suffix}", film)
    store.write_provenance(
        {
            **store.provenance(),
            "figures_identity": identity,
            "figures": {
                stem: {"caption": drawing.caption, "alt": drawing.alt}
                for stem, drawing in drawings.items()
            },
            "files": file_digests(store),
        }
    )
