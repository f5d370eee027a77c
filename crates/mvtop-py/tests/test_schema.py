"""The schemas that `mvtop-cli schema` prints hold for what mvtop reads and writes."""

import copy
import json

import jsonschema
import pytest
from conftest import ROOT

import mvtop


@pytest.fixture
def schema_of(cli):
    return lambda kind: json.loads(cli("schema", kind).stdout)


@pytest.fixture
def check(schema_of):
    """Refuses a document that its schema does not allow; returns the schema."""

    def validate(kind, document):
        of = schema_of(kind)
        jsonschema.Draft202012Validator.check_schema(of)
        jsonschema.Draft202012Validator(of).validate(document)
        return of

    return validate


def closed(schema):
    """The same schema, with no key allowed that it does not name."""
    schema = copy.deepcopy(schema)
    for of in (schema, *schema["$defs"].values()):
        if "properties" in of:
            of["additionalProperties"] = False
    return schema


def test_predictions_have_the_keys_of_their_schema_and_no_others(check):
    rig, images = mvtop.example()
    request = mvtop.Request(classes=["mvball"], frame="world", min_confidence=0.5, most=1)
    tracks = mvtop.Tracks()
    predict = mvtop.Estimator.load().predict
    for answer in (predict(images, rig), predict(images, rig, request=request, tracks=tracks)):
        document = json.loads(answer.to_json())
        assert document["objects"]
        schema = check("prediction", document)
        jsonschema.Draft202012Validator(closed(schema)).validate(document)
        del document["objects"][0]["T_ref_obj"]
        with pytest.raises(jsonschema.ValidationError, match="T_ref_obj"):
            check("prediction", document)


def test_a_request_is_what_its_schema_allows(check):
    pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 1]]
    prior = mvtop.Prior(class_name="mvball", world_from_obj=pose, sigma_m=0.01, sigma_deg=5)
    request = mvtop.Request(
        classes=["mvball"],
        region=[[0, 0, 0], [1, 1, 1]],
        priors=[prior],
        planes=[mvtop.Plane(point=[0, 0, 0], normal=[0, 0, 1], within_m=0.01, within_deg=5)],
        polygons={"cam0": [[0, 0], [9, 0], [9, 9]]},
    )
    document = json.loads(request.to_json())
    check("request", document)
    with pytest.raises(jsonschema.ValidationError, match="class"):
        check("request", {"class": "mvball"})


@pytest.mark.parametrize(
    "folder", ["models/mvball", "models/ycbv4", "models/parts", "fixtures/tiny"]
)
def test_bundles_are_what_their_schema_allows(check, folder):
    document = json.loads((ROOT / folder / "model.json").read_text())
    check("bundle", document)
    del document["graphs"]
    with pytest.raises(jsonschema.ValidationError, match="graphs"):
        check("bundle", document)


def test_rig_files_are_what_their_schema_allows(check):
    files = [*ROOT.glob("examples/*/rig.json"), *ROOT.glob("fixtures/*/sample/rig.json")]
    assert len(files) > 2
    for file in files:
        check("rig", json.loads(file.read_text()))
    rig = mvtop.Rig.from_arrays(
        [[600, 0.5, 320], [0, 600, 240], [0, 0, 1]],
        [[[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]],
        (640, 480),
        distortion=[0.1, 0, 0, 0],
    )
    document = json.loads(rig.to_json())
    assert document["cameras"][0]["skew"] == 0.5
    check("rig", document)


def test_each_key_of_the_rig_schema_is_read_and_no_other(check, schema_of):
    schema = schema_of("rig")
    camera = {
        "id": "a",
        "width": 640,
        "height": 480,
        "model": "pinhole",
        "fx": 600,
        "fy": 600,
        "cx": 320,
        "cy": 240,
        "skew": 0,
        "distortion": {"model": "brown_conrady", "params": []},
        "max_angle_deg": 60,
    }
    document = {
        "format": "mvtop-rig",
        "version": 1,
        "unit": "mm",
        "reference": "a",
        "trust_unit": True,
        "cameras": [camera],
    }
    rows = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 5], [0, 0, 0, 1]]
    ways = [
        rows,
        {"t": [0, 0, 5], "q_wxyz": [1, 0, 0, 0]},
        {"t": [0, 0, 5], "q_xyzw": [0, 0, 0, 1]},
    ]
    for key in ("T_world_cam", "T_cam_world"):
        for way in ways:
            document["cameras"] = [camera | {key: way}]
            check("rig", document)
            mvtop.Rig.from_json(json.dumps(document))
    tried = set(camera) | {"T_world_cam", "T_cam_world"}
    assert tried == set(schema["$defs"]["Camera"]["properties"])
    assert set(document) == set(schema["properties"])
    document["cameras"][0]["focal"] = 600
    with pytest.raises(jsonschema.ValidationError, match="focal"):
        check("rig", document)
    with pytest.raises(ValueError, match="focal"):
        mvtop.Rig.from_json(json.dumps(document))


def test_the_settings_have_their_defaults(check, schema_of):
    schema = schema_of("inference")
    check("inference", {group: key["default"] for group, key in schema["properties"].items()})
    assert schema["properties"]["search"]["default"]["merge_deg"] == 25.0
