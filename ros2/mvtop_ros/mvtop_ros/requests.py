"""From what a service or an action is asked to a `mvtop.Request`."""

from dataclasses import replace

import mvtop


def request_of(message):
    """The request of a `FindPoses`; its own fields replace what its JSON says."""
    asked = mvtop.Request.from_json(message.request) if message.request else mvtop.Request()
    given = {}
    if message.classes:
        given["classes"] = list(message.classes)
    if message.most:
        given["most"] = int(message.most)
    if message.min_confidence:
        given["min_confidence"] = float(message.min_confidence)
    return replace(asked, **given)


def is_accepted(prediction, request):
    """Whether there are objects and, where a confidence was asked for, all are accepted."""
    verdicts = {found.verdict for found in prediction}
    return bool(verdicts) and (request.min_confidence is None or verdicts == {"accept"})
