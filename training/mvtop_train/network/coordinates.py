"""Object coordinates in 8 bits per axis: half the object's extent on either side of 128."""

ZERO, STEPS = 128, 120  # code of the object's origin; codes per extent


def decode(code):
    """Codes [..., 3] uint8 (tensor or array) to units of the object's extent, and a mask [...].

    The mask says where there is a coordinate: code 0 means "not the object".
    """
    return (code - float(ZERO)) / STEPS, (code != 0).all(-1)
