"""Errors of poses against the truth, under their published names.

docs/how-to/evaluate-on-bop.md lists them.
"""

from mvtop._mvtop import (
    Mesh,
    Surface,
    Symmetries,
    auc_exact,
    auc_poet,
    auc_posecnn,
    average_recall,
    recall,
    rotation_error_deg,
    translation_error,
    vsd,
)

__all__ = [
    "Mesh",
    "Surface",
    "Symmetries",
    "auc_exact",
    "auc_poet",
    "auc_posecnn",
    "average_recall",
    "recall",
    "rotation_error_deg",
    "translation_error",
    "vsd",
]
