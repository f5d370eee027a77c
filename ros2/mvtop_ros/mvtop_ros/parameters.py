"""The parameters of the nodes, with their bounds."""

from dataclasses import dataclass

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor


@dataclass(frozen=True)
class Parameter:
    """A parameter as it is declared."""

    default: object
    """A list of texts is never empty, as its type is then not known: `[""]` is one without any."""
    text: str
    low: float | None = None
    high: float | None = None
    choices: str = ""

    def descriptor(self):
        """It cannot be changed while the node is configured."""
        described = ParameterDescriptor(description=self.text, additional_constraints=self.choices)
        if isinstance(self.default, float):
            bounds = FloatingPointRange(from_value=float(self.low), to_value=float(self.high))
            described.floating_point_range = [bounds]
        elif isinstance(self.default, int) and not isinstance(self.default, bool):
            bounds = IntegerRange(from_value=int(self.low), to_value=int(self.high), step=1)
            described.integer_range = [bounds]
        return described


MODEL = Parameter("", "Folder of the model; the wheel's own where it is empty.")
THREADS = Parameter(0, "Threads of the network; 0 for one per processor core.", 0, 1024)
WAITING = Parameter(2, "Requests that may wait while another one is worked on.", 0, 32)

NODE = {
    "model": MODEL,
    "rig": Parameter("", "Rig file; where it is empty, camera_info and TF say the calibration."),
    "cameras": Parameter([""], "Names of the cameras; the rig file's where it is empty."),
    "image_topic": Parameter("{camera}/image_raw", "Topic of images, of each camera."),
    "info_topic": Parameter("{camera}/camera_info", "Topic of calibrations, of each camera."),
    "transport": Parameter("raw", "How images come.", choices="raw, compressed"),
    "reliable": Parameter(
        False, "Whether lost images are sent again; cameras must publish reliably then."
    ),
    "rectified": Parameter(False, "Whether images are rectified, so that P of camera_info counts."),
    "world_frame": Parameter("world", "Frame of the poses; with a rig file, its world frame."),
    "slop_s": Parameter(0.04, "Greatest time between two images of an exposure, s.", 0, 10),
    "min_cameras": Parameter(1, "Fewest images of an exposure.", 1, 64),
    "silent_after_s": Parameter(
        2.0, "How long images wait for those of other cameras, s.", 0.1, 3600
    ),
    "tf_tolerance_s": Parameter(0.5, "How much older than an image its TF may be, s.", 0, 3600),
    "continuous": Parameter(True, "Whether each exposure is worked on, or requests alone are."),
    "classes": Parameter([""], "Classes that are published without a request; all by default."),
    "min_confidence": Parameter(
        0.0, "Poses of less confidence are not published without a request.", 0, 1
    ),
    "track": Parameter(True, "Whether objects keep their id and frame over time."),
    "max_motion_m": Parameter(
        0.0, "Farthest that an object moves between exposures, m; 0 for half its diameter.", 0, 100
    ),
    "publish_tf": Parameter(True, "Whether found objects are published on /tf."),
    "publish_rig": Parameter(True, "Whether cameras of a rig file are published on /tf_static."),
    "publish_markers": Parameter(True, "Whether markers are published."),
    "waiting": WAITING,
    "timeout_s": Parameter(10.0, "How long a request waits for images, s.", 0.1, 3600),
    "threads": THREADS,
    "autostart": Parameter(True, "Whether the node configures and activates itself."),
}

CHALLENGE = {
    "model_dir": Parameter("", "Folder of the model."),
    "use_photoneo": Parameter(True, "Whether the photoneo's image is used as well."),
    "min_confidence": Parameter(0.0, "Poses of less confidence are not given.", 0, 1),
    "waiting": WAITING,
    "threads": THREADS,
}

_TRANSPORTS = ("raw", "compressed")


def declare(node, table):
    """Declares all parameters of a table."""
    for name, one in table.items():
        node.declare_parameter(name, one.default, one.descriptor())


def read(node, table):
    """Their values by name; lists come without empty texts."""
    values = {}
    for name in table:
        value = node.get_parameter(name).value
        is_list = isinstance(table[name].default, list)
        values[name] = [text for text in value if text] if is_list else value
    return values


def check(values):
    """Refuses values that cannot be meant, by a sentence."""
    if values["transport"] not in _TRANSPORTS:
        raise ValueError(
            f"transport: expected one of {', '.join(_TRANSPORTS)}, got `{values['transport']}`"
        )
    for name in ("image_topic", "info_topic"):
        if "{camera}" not in values[name]:
            raise ValueError(f"{name}: expected a topic with {{camera}}, got `{values[name]}`")
    cameras = values["cameras"]
    if not values["rig"] and not cameras:
        raise ValueError("cameras: expected names of cameras or a rig file, got neither")
    if len(set(cameras)) != len(cameras):
        raise ValueError(f"cameras: expected each name once, got {', '.join(cameras)}")


def check_classes(values, classes):
    """Refuses names that the model does not know.

    - classes: those that it knows, by name
    """
    for name in values["classes"]:
        if name not in classes:
            known = ", ".join(classes)
            raise ValueError(f"classes: no class `{name}` in the model, expected one of: {known}")
