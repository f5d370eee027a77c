use mvtop_import::Format;

use super::{MINUS_Y, X, Z};
use crate::{assert_params, assert_plane, assert_pose, read, refusal, scaled};

fn matrix(key: &str, rows: usize, cols: usize, data: &str) -> String {
    format!(
        "<{key} type_id=\"opencv-matrix\"><rows>{rows}</rows><cols>{cols}</cols><dt>d</dt>\n<data>\n {data}\
         </data></{key}>\n"
    )
}

#[test]
fn opencv_xml_says_what_its_yaml_says() {
    let parts = [
        matrix("M1", 3, 3, "700. 0. 320. 0. 710. 240. 0. 0. 1."),
        matrix("D1", 1, 5, "-1.e-1 2.e-2\n 0. 0. 0."),
        matrix("M2", 3, 3, "600. 0. 330. 0. 610. 250. 0. 0. 1."),
        matrix("D2", 1, 5, "0. 0. 0. 0. 0."),
        matrix("R", 3, 3, "0. -1. 0. 1. 0. 0. 0. 0. 1."),
        matrix("T", 3, 1, "-4. 0. 0."),
    ];
    let text = format!(
        "<?xml version=\"1.0\"?>\n<opencv_storage>\n<calibration_time>\"Fri Nov 27 10:00:00\"</calibration_time>\n\
         {}<image_width>640</image_width>\n<image_height>480</image_height>\n</opencv_storage>\n",
        parts.concat()
    );
    let imported = read(&[("stereo.xml", &text)], &scaled(0.025)).unwrap();
    assert_eq!(imported.format, Format::OpenCv);
    let [first, second] = imported.rig.cameras() else {
        panic!("two cameras")
    };
    assert_plane(first, [700.0, 710.0, 320.0, 240.0]);
    assert_params(first, &[-0.1, 0.02, 0.0, 0.0, 0.0]);
    assert_plane(second, [600.0, 610.0, 330.0, 250.0]);
    assert_eq!([second.width(), second.height()], [640, 480]);
    assert_pose(first, [0.0; 3], X, Z);
    assert_pose(second, [0.0, -0.1, 0.0], MINUS_Y, Z);
}

#[test]
fn other_xml_says_what_it_is() {
    let error = refusal(&[("a.xml", "<project><chunk/></project>")], &scaled(1.0));
    assert!(error.contains("got XML of `project`"), "{error}");
}
