"""From the core's answer to Python's classes, and from these to the document of `to_json`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from mvtop._mvtop import REPORT_SCHEMA_VERSION
from mvtop._objects import (
    CameraPose,
    Grasp,
    Hypothesis,
    NearMiss,
    ObjectPose,
    PredictionWarning,
    Refinement,
    RigConsistency,
    Sigma,
    Undetermined,
)

if TYPE_CHECKING:
    from mvtop._prediction import Prediction


def fields(values: Mapping[str, Any]) -> dict[str, Any]:
    """What a `Prediction` is made of, of what `NativePrediction.values` gives."""
    fit = values["rig_consistency"]
    return {
        **values,
        "objects": [_object(found) for found in values["objects"]],
        "rig_consistency": None if fit is None else RigConsistency(**fit),
        "warnings": [PredictionWarning(**warning) for warning in values["warnings"]],
        "why": None if values["why"] is None else [NearMiss(**miss) for miss in values["why"]],
    }


def _object(values: Mapping[str, Any]) -> ObjectPose:
    def refinement(one: Mapping[str, Any]) -> Refinement:
        return Refinement(**{**one, "initial_sigma": Sigma(**one["initial_sigma"])})

    def hypothesis(one: Mapping[str, Any]) -> Hypothesis:
        return Hypothesis(**{**one, "sigma": Sigma(**one["sigma"])})

    refined, symmetry = values["refinement"], values["symmetry"]
    grasps = values["grasps"]
    return ObjectPose(
        **{
            **values,
            "sigma": Sigma(**values["sigma"]),
            "refinement": None if refined is None else refinement(refined),
            "hypotheses": [hypothesis(one) for one in values["hypotheses"]],
            "symmetry": None if symmetry is None else Undetermined(**symmetry),
            "cameras": {seen["id"]: CameraPose(**seen) for seen in values["cameras"]},
            "grasps": None if grasps is None else [Grasp(**one) for one in grasps],
        }
    )


def document(prediction: Prediction) -> dict[str, Any]:
    """The document that docs/reference/json.md describes."""
    fit = prediction.rig_consistency
    why = None if prediction.why is None else [_missed(miss) for miss in prediction.why]
    return {
        "schema_version": REPORT_SCHEMA_VERSION,
        "reference": prediction.reference,
        "objects": [_reported(found) for found in prediction.objects],
        "rig_consistency": None if fit is None else dict(fit.__dict__),
        "timings_ms": dict(prediction.timings_ms),
        "model": prediction.model,
        "provider": prediction.provider,
        "warnings": [dict(warning.__dict__) for warning in prediction.warnings],
        **_asked(frame=prediction.frame, left_out=prediction.left_out, why=why),
    }


def _missed(miss: NearMiss) -> dict[str, Any]:
    box, pose = miss.box, miss.world_from_obj
    return {
        "class": miss.class_name,
        "reason": miss.reason,
        "camera": miss.camera,
        "box": None if box is None else box.tolist(),
        "T_world_obj": None if pose is None else pose.tolist(),
        "value": miss.value,
        "threshold": miss.threshold,
        "message": miss.message,
    }


def _asked(**values: Any) -> dict[str, Any]:
    """What is in the document only where it was asked for."""
    return {name: value for name, value in values.items() if value is not None}


def _reported(found: ObjectPose) -> dict[str, Any]:
    def sigma(one: Sigma) -> dict[str, float]:
        return dict(one.__dict__)

    def refinement(one: Refinement) -> dict[str, Any]:
        return {**one.__dict__, "initial_sigma": sigma(one.initial_sigma)}

    def hypothesis(one: Hypothesis) -> dict[str, Any]:
        return {
            "T_world_obj": one.world_from_obj.tolist(),
            "sigma": sigma(one.sigma),
            "probability": one.probability,
        }

    def symmetry(one: Undetermined) -> dict[str, Any]:
        axis = one.axis
        parts = None if axis is None else {"direction": axis[0].tolist(), "point": axis[1].tolist()}
        return {"poses": one.poses, "axis": parts}

    def camera(seen: CameraPose) -> dict[str, Any]:
        return {
            "id": seen.id,
            "T_cam_obj": seen.cam_from_obj.tolist(),
            "box": None if seen.box is None else seen.box.tolist(),
            "detected": seen.box is not None,
        }

    def grasp(one: Grasp) -> dict[str, Any]:
        return {
            "name": one.name,
            "T_frame_tool": one.frame_from_tool.tolist(),
            "opening_m": one.opening_m,
            "collides": one.collides,
            "collides_with": one.collides_with,
        }

    in_frame = found.frame_from_obj
    # As the core's, which leaves it out of single predictions.
    track = {} if found.track_id is None else {"track_id": found.track_id}
    return {
        "class": found.class_name,
        "class_id": found.class_id,
        "score": found.score,
        "T_ref_obj": found.ref_from_obj.tolist(),
        "T_world_obj": found.world_from_obj.tolist(),
        "t_m": found.ref_from_obj[:3, 3].tolist(),
        "q_wxyz": found.quat_wxyz.tolist(),
        "sigma": sigma(found.sigma),
        "coordinate_inliers": found.coordinate_inliers,
        "refinement": None if found.refinement is None else refinement(found.refinement),
        "confidence": found.confidence,
        "evidence": found.evidence,
        "verdict": found.verdict,
        "hypotheses": [hypothesis(one) for one in found.hypotheses],
        "next_view": found.next_view,
        "symmetry": None if found.symmetry is None else symmetry(found.symmetry),
        "cameras": [camera(seen) for seen in found.cameras.values()],
        **_asked(
            T_frame_obj=None if in_frame is None else in_frame.tolist(),
            grasps=None if found.grasps is None else [grasp(one) for one in found.grasps],
        ),
        **track,
    }
