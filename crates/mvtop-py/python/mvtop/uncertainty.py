"""What expected and actual errors of poses say of each other."""

from mvtop._mvtop import auroc, calibration, correlation, roc_curve

__all__ = ["auroc", "calibration", "correlation", "roc_curve"]
