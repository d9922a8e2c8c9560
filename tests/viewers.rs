//! The suite with stock viewers: the layouts in `docs/layouts`, a real rclpy without our messages, and Rerun's reader
//! of bags.

use std::{
    collections::{BTreeMap, BTreeSet},
    process::Command,
    time::Duration,
};

use serde_json::Value;

use crate::{
    harness::{
        Process, WM, bundled_bag, fresh_domain, peers, rclpy, root, whole_suite, wm, wm_node,
    },
    interop::{integer, messages},
};

/// The topics of every node, which `wm nodes --topics` does not repeat for each.
const OF_EVERY_NODE: [(&str, &str); 2] = [
    ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray"),
    ("/rosout", "rcl_interfaces/msg/Log"),
];
const JPEG: &str = "sensor_msgs/msg/CompressedImage";
const NUMBER: &str = "std_msgs/msg/Float64";

/// Published topics with their types, from `wm nodes --topics`, in the namespace of the launch files.
fn published() -> BTreeMap<String, String> {
    let output = Command::new(WM).args(["nodes", "--topics"]).output();
    let output = output.expect("wm runs");
    assert!(output.status.success(), "{output:?}");
    let table = String::from_utf8(output.stdout).expect("text");
    let mut published: BTreeMap<_, _> = OF_EVERY_NODE
        .map(|(name, type_name)| (name.to_owned(), type_name.to_owned()))
        .into();
    for row in table.lines() {
        let cells: Vec<&str> = row.split('|').map(str::trim).collect();
        let ["", node, "publishes", name, type_name, ..] = cells[..] else {
            continue;
        };
        let (name, type_name) = (name.trim_matches('`'), type_name.trim_matches('`'));
        let name = match name.strip_prefix("~/") {
            Some(own) => format!("/wm/{node}/{own}"),
            None if name.starts_with('/') => name.to_owned(),
            None => format!("/wm/{name}"),
        };
        published.insert(name, type_name.to_owned());
    }
    assert!(published.len() > 30, "{published:?}");
    published
}

/// The topics of a Foxglove layout, with the types that their panels accept.
fn of_layout(layout: &Value) -> Vec<(String, Vec<&'static str>)> {
    let panels = layout["configById"].as_object().expect("panels");
    let mut named = Vec::new();
    let mut name = |topic: &Value, types: &[&'static str]| {
        let topic = topic.as_str().expect("a topic's name").to_owned();
        named.push((topic, types.to_vec()));
    };
    for (id, panel) in panels {
        match id.split_once('!').expect("kind!name").0 {
            "Image" => {
                name(&panel["imageMode"]["imageTopic"], &[JPEG]);
                if let Some(calibration) = panel["imageMode"].get("calibrationTopic") {
                    name(calibration, &["sensor_msgs/msg/CameraInfo"]);
                }
            }
            "3D" => {
                for topic in panel["topics"].as_object().expect("topics").keys() {
                    let shown = [
                        "visualization_msgs/msg/MarkerArray",
                        "sensor_msgs/msg/CameraInfo",
                        "geometry_msgs/msg/PoseStamped",
                        "geometry_msgs/msg/PoseArray",
                    ];
                    name(&topic.as_str().into(), &shown);
                }
                for layer in panel["layers"].as_object().expect("layers").values() {
                    if layer["layerId"] == "foxglove.Urdf" {
                        name(&layer["topic"], &["std_msgs/msg/String"]);
                    }
                }
            }
            "Plot" => {
                for path in panel["paths"].as_array().expect("paths") {
                    let value = path["value"].as_str().expect("a message path");
                    let topic = value.strip_suffix(".data").expect("a number's data");
                    name(&topic.into(), &[NUMBER]);
                }
            }
            "DiagnosticSummary" => name(&panel["topicToRender"], &[OF_EVERY_NODE[0].1]),
            "RosOut" => name(&panel["topicToRender"], &[OF_EVERY_NODE[1].1]),
            other => panic!("{other}: which topics does such a panel show?"),
        }
    }
    named
}

/// The panels that a Foxglove layout shows.
fn places(tree: &Value) -> BTreeSet<&str> {
    match tree.as_str() {
        Some(panel) => BTreeSet::from([panel]),
        None => ["first", "second"]
            .into_iter()
            .flat_map(|half| places(&tree[half]))
            .collect(),
    }
}

#[test]
fn layouts_name_published_topics_with_fitting_types() {
    let published = published();
    let folder = root().join("docs/layouts");
    let text = std::fs::read_to_string(folder.join("wm.foxglove.json")).expect("the layout");
    let layout: Value = serde_json::from_str(&text).expect("JSON");
    let named = of_layout(&layout);
    assert!(named.len() > 15, "{named:?}");
    for (topic, types) in &named {
        let found = published.get(topic).map(String::as_str);
        assert!(
            found.is_some_and(|found| types.contains(&found)),
            "{topic}: expected one of {types:?}, found {found:?}"
        );
    }
    let panels = layout["configById"].as_object().expect("panels");
    let panels: BTreeSet<&str> = panels.keys().map(String::as_str).collect();
    assert_eq!(places(&layout["layout"]), panels, "each has one place");

    // Rerun's blueprint names them as Python strings
    let script = std::fs::read_to_string(folder.join("wm_rerun.py")).expect("the blueprint");
    let strings = script.split('"').skip(1).step_by(2);
    let topics: Vec<&str> = strings
        .filter(|text| published.contains_key(*text))
        .collect();
    let unknown: Vec<&str> = script
        .split('"')
        .filter(|text| text.starts_with("/wm/") || text.starts_with("/camera/"))
        .filter(|text| !published.contains_key(*text))
        .collect();
    assert_eq!(unknown, Vec::<&str>::new());
    assert!(topics.len() > 10, "{topics:?}");
    for topic in topics {
        let expected = match topic {
            "/rosout" => OF_EVERY_NODE[1].1,
            _ if topic.ends_with("/compressed") => JPEG,
            _ => NUMBER,
        };
        assert_eq!(published[topic], expected, "{topic}");
    }
}

#[test]
fn rclpy_without_our_messages_gets_markers_and_cameras() {
    let Some(peers) = peers() else { return };
    let _whole = whole_suite();
    let domain = fresh_domain();
    let arm_yaml = root().join("launch-configs/config/arm.yaml");
    let arm_yaml = arm_yaml.display().to_string();
    let node = |args: &[&str]| Process::start(wm(domain, args));
    let of_arm = ["--ros-args", "--params-file", &*arm_yaml];
    let _nodes = [
        // the camera rests, but with noise the ratio to the persistence baseline is a number
        Process::start(wm_node(
            domain,
            "sim_arm",
            &["task:=reach", "seed:=5000000", "noise:=3.0"],
        )),
        node(&["run", "encoder", "predictor", "decoder"]),
        node(&[&["planner"], &of_arm[..], &["-p", "planner:=idm"]].concat()),
        node(
            &[
                &["executor"],
                &of_arm[..],
                &["-p", "workspace_min:=[0.1, -0.3, 0.0]"],
                &["-p", "workspace_max:=[0.5, 0.3, 0.4]"],
            ]
            .concat(),
        ),
    ];
    let args = [
        "--seconds",
        "120",
        "/wm/markers:visualization_msgs/msg/MarkerArray:80",
        "/camera/camera_info:sensor_msgs/msg/CameraInfo:5",
        "/wm/predicted/camera_info:sensor_msgs/msg/CameraInfo:16",
        "/wm/predicted/image/compressed:sensor_msgs/msg/CompressedImage:16",
        "/wm/prediction_error/ratio_k1:std_msgs/msg/Float64:8",
        "/wm/prediction_error/ratio_k8:std_msgs/msg/Float64:2",
        "/wm/prediction_latency/k1:std_msgs/msg/Float64:4",
        "/wm/prediction_latency/k8:std_msgs/msg/Float64:4",
        "/wm/trust/error_ratio:std_msgs/msg/Float64:2",
        "/wm/trust/unlike_training:std_msgs/msg/Float64:2",
        "/wm/robot_description:std_msgs/msg/String:1:latched",
    ];
    let peer = Process::start(rclpy(&peers, domain, "collect.py", &args));
    let (status, stdout) = peer.finish(Duration::from_secs(150));
    assert!(status.success(), "collect.py: {status}");
    let report: Value = serde_json::from_str(&stdout).expect("collect.py prints JSON");

    let mut shapes: BTreeMap<&str, Vec<&Value>> = BTreeMap::new();
    for message in messages(&report, "/wm/markers") {
        for marker in message["markers"].as_array().expect("markers") {
            assert_eq!(marker["header"]["frame_id"], "base_link", "{marker}");
            assert_eq!(marker["pose"]["orientation"]["w"], 1.0, "{marker}");
            assert!(integer(&marker["lifetime"]) > 0, "{marker}");
            let ns = marker["ns"].as_str().expect("text");
            shapes.entry(ns).or_default().push(marker);
        }
    }
    assert_eq!(
        shapes.keys().copied().collect::<Vec<_>>(),
        ["goal", "plan", "workspace"]
    );
    let number = |value: &Value| value.as_f64().expect("a number");
    // plans begin at the tool, on the table's side of the arm, and each of four steps takes it a little further
    let ways = shapes["plan"].iter().filter(|marker| marker["id"] == 0);
    for way in ways {
        let points = way["points"].as_array().expect("points");
        assert_eq!(points.len(), 5, "{way}");
        for pair in points.windows(2) {
            let apart = ["x", "y", "z"].map(|axis| number(&pair[1][axis]) - number(&pair[0][axis]));
            let apart = apart.iter().map(|part| part * part).sum::<f64>().sqrt();
            assert!(apart < 0.3, "{way}");
        }
    }
    let edges = shapes["workspace"][0]["points"].as_array().expect("points");
    assert_eq!(edges.len(), 24);
    assert!(
        edges
            .iter()
            .all(|at| [0.1, 0.5].contains(&number(&at["x"])))
    );

    let (real, predicted) = (
        &messages(&report, "/camera/camera_info")[0],
        messages(&report, "/wm/predicted/camera_info"),
    );
    let stamps = |topic: &str| -> BTreeSet<i64> {
        let all = messages(&report, topic).iter();
        all.map(|message| integer(&message["header"]["stamp"]))
            .collect()
    };
    let pictures = stamps("/wm/predicted/image/compressed");
    let shared = pictures
        .intersection(&stamps("/wm/predicted/camera_info"))
        .count();
    assert!(
        shared * 2 > pictures.len(),
        "{shared} of {}",
        pictures.len()
    );
    for info in predicted {
        assert_eq!(info["header"]["frame_id"], real["header"]["frame_id"]);
        let smaller = number(&info["width"]) / number(&real["width"]);
        let focal = number(&info["k"][0]) / number(&real["k"][0]);
        assert!((focal - smaller).abs() < 1e-9, "{info}");
    }

    let mean = |topic: &str| {
        let values: Vec<f64> = messages(&report, topic)
            .iter()
            .map(|message| number(&message["data"]))
            .collect();
        values.iter().sum::<f64>() / values.len() as f64
    };
    let (first, last) = (
        mean("/wm/prediction_latency/k1"),
        mean("/wm/prediction_latency/k8"),
    );
    assert!(0.0 < first && first < last && last < 60.0, "{first} {last}");
    for topic in [
        "/wm/prediction_error/ratio_k1",
        "/wm/prediction_error/ratio_k8",
        "/wm/trust/error_ratio",
    ] {
        assert!(mean(topic) > 0.0, "{topic}");
    }
    assert!((0.0..=1.0).contains(&mean("/wm/trust/unlike_training")));
    let description = messages(&report, "/wm/robot_description")[0]["data"].to_string();
    assert!(description.contains("ee_gripper_link"), "{description}");
}

/// Components by topic that Rerun's reader finds in the .mcap files of a bag, with their number of rows.
fn by_rerun(
    peers: &std::path::Path,
    bag: &std::path::Path,
) -> BTreeMap<String, BTreeMap<String, i64>> {
    let mut command = Command::new(peers.join("rerun/bin/python"));
    command
        .arg(root().join("tests/interop/rerun_read.py"))
        .arg(root().join("docs/layouts/wm_rerun.py"))
        .arg(bag);
    let (status, stdout) = Process::start(command).finish(Duration::from_secs(120));
    assert!(status.success(), "rerun_read.py: {status}");
    serde_json::from_str(&stdout).expect("rerun_read.py prints JSON")
}

#[test]
fn rerun_reads_pictures_frames_and_numbers_of_bags() {
    let Some(peers) = peers() else { return };
    if !peers.join("rerun/bin/python").is_file() {
        // half a gigabyte: failing would be wrong if nobody wanted it
        eprintln!(
            "skipped: no Rerun under .venv/rerun; run tests/setup_rerun (RERUN=1 tests/run does)"
        );
        return;
    }
    let bag = bundled_bag();
    let found = by_rerun(&peers, &bag);
    let rows = |topic: &str, component: &str| {
        let of_topic = found
            .get(topic)
            .unwrap_or_else(|| panic!("{topic}: {found:?}"));
        let rows = of_topic.get(component);
        *rows.unwrap_or_else(|| panic!("{topic}: {component} is none of {of_topic:?}"))
    };
    assert_eq!(
        rows("/camera/image_raw/compressed", "EncodedImage:blob"),
        50
    );
    assert_eq!(rows("/camera/camera_info", "Pinhole:image_from_camera"), 50);
    assert_eq!(
        rows("/arm/end_effector_pose", "InstancePoses3D:translations"),
        50
    );
    assert_eq!(rows("/tf", "Transform3D:translation"), 10 * 50);
    assert_eq!(rows("/tf_static", "Transform3D:translation"), 1);
    // from the URDF, Rerun builds the arm: a link has the forms of the description
    let link = "/wx250s/visual_geometries/base_link/visual_0";
    assert_eq!(rows(link, "Boxes3D:half_sizes"), 1);
    assert_eq!(rows("/task/instruction", "TextDocument:text"), 1);
    let numbers = "std_msgs.msg.Float32:message.data";
    assert_eq!(rows("/arm/gripper", numbers), 50);
}
