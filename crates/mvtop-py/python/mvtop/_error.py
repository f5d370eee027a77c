class Error(Exception):
    """What is wrong with ONNX Runtime or a model bundle.

    Values and shapes that are refused raise ValueError, files that cannot be read OSError.
    """


Error.__module__ = "mvtop"
