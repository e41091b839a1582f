"""Which of the parameters that the paper leaves open decide its headline numbers."""

from softwave_min.studies.sensitivity.samples import SEA, Study, study_settings
from softwave_min.studies.sensitivity.study import NAME, investigate
from softwave_min.studies.sensitivity.tables import (
    complete,
    importance,
    important,
    number_names,
    on_scale,
)

__all__ = [
    "NAME",
    "SEA",
    "Study",
    "complete",
    "importance",
    "important",
    "investigate",
    "number_names",
    "on_scale",
    "study_settings",
]
