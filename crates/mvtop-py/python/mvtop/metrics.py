"""Errors of poses against the truth, under the names they were published by (docs/bop.md)."""

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
