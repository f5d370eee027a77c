"""Data sets in BOP's layout, read as `mvtop-cli eval bop` reads them (docs/bop.md), in metres."""

from mvtop._mvtop import Image, Instance, ModelInfo, read_models_info, read_scene

__all__ = ["Image", "Instance", "ModelInfo", "read_models_info", "read_scene"]
