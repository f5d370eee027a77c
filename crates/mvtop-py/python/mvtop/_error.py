class Error(Exception):
    """What is wrong with ONNX Runtime or a model bundle.

    Values and shapes that are refused raise ValueError, files that cannot be read OSError.
    """


class MvtopWarning(UserWarning):
    """What makes poses, or data that was read, doubtful though it is no error.

    `Prediction.warnings` has the same of a prediction, with codes for programs.
    """


Error.__module__ = MvtopWarning.__module__ = "mvtop"
