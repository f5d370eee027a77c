"""The paper's own network, which no shipped model uses: of whole images.
Positions are fractions of them. What this reaches: docs/decisions/0002-geometry-through-rays.md.
"""

from ..network.config import Config

PAPER = Config(
    preset="paper", width=640, height=480, backbone="resnet50_fpn", channels=(),
    strides=(16, 32, 64, 128), d_model=256, heads=16, points=4, encoder_layers=5,
    decoder_layers=5, ffn=1024, los_encoding="origin_direction", geometry="image",
    mean=(0.485, 0.456, 0.406), std=(0.229, 0.224, 0.225),
)  # fmt: skip
