"""The service and the action: requests of others, and their answers."""

import time

from mvtop_interfaces.action import FindPoses as FindPosesAction
from mvtop_interfaces.srv import FindPoses
from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup

import mvtop
from mvtop_ros import detections
from mvtop_ros.finder import BusyError
from mvtop_ros.requests import is_accepted, request_of

# What a request may fail by, each with a sentence.
PROBLEMS = (ValueError, LookupError, OSError, BusyError, mvtop.Error)


class Answers:
    """Answers requests by what the node finds."""

    def __init__(self, node, newest, timeout_s):
        """
        - node: a `PoseNode`
        - newest: the exposures
        - timeout_s: how long a request waits for one
        """
        self._node, self._newest, self._timeout_s = node, newest, timeout_s
        group = ReentrantCallbackGroup()
        self._service = node.create_service(
            FindPoses, "~/find_poses", self._serve, callback_group=group
        )
        self._action = ActionServer(
            node,
            FindPosesAction,
            "~/find_poses_action",
            execute_callback=self._execute,
            goal_callback=lambda _goal: GoalResponse.ACCEPT,
            cancel_callback=lambda _goal: CancelResponse.ACCEPT,
            callback_group=group,
        )

    def close(self):
        """Ends both."""
        self._action.destroy()
        self._node.destroy_service(self._service)

    def _serve(self, request, response):
        return self._answer(request, response, lambda _stage: True)

    def _execute(self, goal):
        def go_on(stage):
            if goal.is_cancel_requested:
                return False
            goal.publish_feedback(FindPosesAction.Feedback(stage=stage))
            return True

        result = self._answer(goal.request, FindPosesAction.Result(), go_on)
        if goal.is_cancel_requested:
            goal.canceled()
        elif result.success:
            goal.succeed()
        else:
            goal.abort()
        return result

    def _answer(self, asked, answer, go_on):
        """Fills in the answer to a service or an action.

        - go_on: told what is done next; whether it is wanted still
        """
        try:
            request = request_of(asked)
            exposure = self._wait(asked.wait_for_new, go_on)
            if exposure is None or not go_on("predicting"):
                answer.message = "expected a request to the end, got its cancellation"
                return answer
            prediction = self._node.find(exposure, request)
        except PROBLEMS as problem:
            answer.message = str(problem)
            self._node.warn_sometimes(answer.message)
            return answer
        except Exception as problem:  # the node must go on
            answer.message = f"prediction: {type(problem).__name__}: {problem}"
            self._node.get_logger().error(answer.message)
            return answer
        answer.success = True
        answer.accepted = is_accepted(prediction, request)
        header = self._node.header_of(exposure)
        answer.detections = detections.detections_of(prediction, header, self._node.classes)
        answer.report = prediction.to_json()
        return answer

    def _wait(self, for_new, go_on):
        """The newest exposure, or the next one; None where it is not wanted any more."""
        seen = self._newest.number if for_new else 0
        until = time.monotonic() + self._timeout_s
        while time.monotonic() < until:
            self._node.refuse_inactive()
            if not go_on("waiting"):
                return None
            exposure = self._newest.after(seen, 0.1)
            if exposure is not None:
                return exposure
        silent = ", ".join(self._node.silent()) or "none"
        raise LookupError(
            f"expected images of one moment within {self._timeout_s} s, got none; cameras that "
            f"are silent: {silent}"
        )
