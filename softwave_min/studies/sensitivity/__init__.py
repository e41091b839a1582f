"""Which of the open values decide the paper's headline numbers, and which do not."""

from softwave_min.studies.sensitivity.samples import SEA, Study, study_settings
from softwave_min.studies.sensitivity.study import NAME, investigate
from softwave_min.studies.sensitivity.tables import (
    importance,
    important,
    judged,
    number_names,
    on_scale,
)

__all__ = [
    "NAME",
    "SEA",
    "Study",
    "importance",
    "important",
    "investigate",
    "judged",
    "number_names",
    "on_scale",
    "study_settings",
]
