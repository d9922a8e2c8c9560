//! Holds our type hashes against those that the real rosidl computed.

use crate::installation::Installation;
use std::collections::BTreeMap;
use wm_msgs::{
    Action, Message, Service, TypeDescription, builtin_interfaces::Time, rcl_interfaces,
};

/// Every type of the crate and its hash.
fn ours() -> BTreeMap<String, String> {
    fn message<M: Message>(hashes: &mut BTreeMap<String, String>) {
        let hash = TypeDescription::of::<M>().unwrap().hash();
        hashes.insert(M::ros_name(), hash.to_string());
    }
    fn service<S: Service>(hashes: &mut BTreeMap<String, String>) {
        let hash = TypeDescription::of_service::<S>().unwrap().hash();
        hashes.insert(S::ros_name(), hash.to_string());
    }
    let mut hashes = BTreeMap::new();
    every_message!(message, &mut hashes);
    every_service!(service, &mut hashes);
    // with all that rosidl makes of it
    fn action<A: Action>(hashes: &mut BTreeMap<String, String>) {
        let whole = TypeDescription::of_action::<A>().unwrap();
        let own = std::iter::once(&whole.described).chain(&whole.referenced);
        for name in own.map(|part| &part.name) {
            if name.starts_with(&A::ros_name()) {
                let described = TypeDescription::action(name, A::DEFINITION, A::dependencies());
                hashes.insert(name.clone(), described.unwrap().hash().to_string());
            }
        }
    }
    every_action!(action, &mut hashes);
    let given = || {
        let time = ("builtin_interfaces/msg/Time", Time::DEFINITION);
        rcl_interfaces::MESSAGES.into_iter().chain([time])
    };
    for (name, text) in rcl_interfaces::MESSAGES {
        let hash = TypeDescription::message(name, text, given())
            .unwrap()
            .hash();
        hashes.insert(name.to_owned(), hash.to_string());
    }
    for (name, text) in rcl_interfaces::SERVICES {
        let hash = TypeDescription::service(name, text, given())
            .unwrap()
            .hash();
        hashes.insert(name.to_owned(), hash.to_string());
    }
    hashes
}

/// From `type_hashes` of the files `share/PACKAGE/{msg,srv,action}/TYPE.json` that ROS 2 Kilted installs.
#[test]
fn known_hashes_are_ours() {
    let known = [
        (
            "builtin_interfaces/msg/Time",
            "RIHS01_b106235e25a4c5ed35098aa0a61a3ee9c9b18d197f398b0e4206cea9acf9c197",
        ),
        (
            "std_msgs/msg/Header",
            "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01",
        ),
        (
            "std_msgs/msg/String",
            "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18",
        ),
        (
            "std_msgs/msg/Float32",
            "RIHS01_7170d3d8f841f7be3172ce5f4f59f3a4d7f63b0447e8b33327601ad64d83d6e2",
        ),
        (
            "sensor_msgs/msg/Image",
            "RIHS01_d31d41a9a4c4bc8eae9be757b0beed306564f7526c88ea6a4588fb9582527d47",
        ),
        (
            "sensor_msgs/msg/CompressedImage",
            "RIHS01_15640771531571185e2efc8a100baf923961a4d15d5569652e6cb6691e8e371a",
        ),
        (
            "sensor_msgs/msg/JointState",
            "RIHS01_a13ee3a330e346c9d87b5aa18d24e11690752bd33a0350f11c5882bc9179260e",
        ),
        (
            "geometry_msgs/msg/PoseStamped",
            "RIHS01_10f3786d7d40fd2b54367835614bff85d4ad3b5dab62bf8bca0cc232d73b4cd8",
        ),
        (
            "geometry_msgs/msg/TransformStamped",
            "RIHS01_0a241f87d04668d94099cbb5ba11691d5ad32c2f29682e4eb5653424bd275206",
        ),
        (
            "geometry_msgs/msg/PoseArray",
            "RIHS01_af0cc36d190e104d546d168d6b39df04fa4b4ccecf59cb4c9ed328d3d5004aa0",
        ),
        (
            "sensor_msgs/msg/CameraInfo",
            "RIHS01_b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275",
        ),
        (
            "trajectory_msgs/msg/JointTrajectory",
            "RIHS01_179b33eba59d676f6d967ac71fe35e7ca2f64b2f3928f4a018cec115e213796e",
        ),
        (
            // From the code that rosidl generated of tf2_msgs.
            "tf2_msgs/msg/TFMessage",
            "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
        ),
        (
            "visualization_msgs/msg/MarkerArray",
            "RIHS01_86cb8800b6fb05b5eff1abd7a56f62a5641d3ae9a1c29e78e67e704f1d067dcf",
        ),
        (
            "geometry_msgs/msg/TwistStamped",
            "RIHS01_5f0fcd4f81d5d06ad9b4c4c63e3ea51b82d6ae4d0558f1d475229b1121db6f64",
        ),
        (
            "std_srvs/srv/Trigger",
            "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
        ),
        (
            "std_srvs/srv/SetBool",
            "RIHS01_abe9e4bb6b41b40e6789712c00ec8871923e089af3f667a79992a428cff2da0a",
        ),
        (
            "diagnostic_msgs/msg/DiagnosticArray",
            "RIHS01_5a8a36efb05fb25070fa0fb3810290c0e6cd4862b54a8fb975a1ee8dc55a333e",
        ),
        (
            "rosgraph_msgs/msg/Clock",
            "RIHS01_692f7a66e93a3c83e71765d033b60349ba68023a8c689a79e48078bcb5c58564",
        ),
        (
            "lifecycle_msgs/msg/TransitionEvent",
            "RIHS01_d5f8873a2f0146498f812d7885c7327ce27e463d36811d8792f35ee38c0d6c38",
        ),
        (
            "lifecycle_msgs/srv/ChangeState",
            "RIHS01_356fe34f0475a43acf54542013af4167b0e729f77ea22ffb045c6ad8e20668e5",
        ),
        (
            "lifecycle_msgs/srv/GetState",
            "RIHS01_800a0a5aae599782b02932de0caf563f6dc4e7e94b794eadde075ba2cbef9795",
        ),
        (
            // From the code that rosidl generated of rosbag2_interfaces.
            "rosbag2_interfaces/srv/Play",
            "RIHS01_e87b287e52219f5f32127c876a0688c537b8a5762612f33b8e740c3b89d19d2b",
        ),
        (
            "action_msgs/msg/GoalStatusArray",
            "RIHS01_6c1684b00f177d37438febe6e709fc4e2b0d4248dca4854946f9ed8b30cda83e",
        ),
        (
            "action_msgs/srv/CancelGoal",
            "RIHS01_573d8b0a534451d7bc2ac8c5ffde8ac14b8593b7001175d0cd6516dcbeb8689a",
        ),
        (
            "lifecycle_msgs/srv/GetAvailableTransitions",
            "RIHS01_59b7ecefce0982a8a844b9f2c4f14764c1c4543cc55e72924e2aa4adad83e9bc",
        ),
    ];
    let ours = ours();
    for (name, hash) in known {
        assert_eq!(ours.get(name).map(String::as_str), Some(hash), "{name}");
    }
}

/// With a ROS installation at hand, every type is held against what its rosidl wrote.
#[test]
fn hashes_are_those_of_the_ros_installation() {
    let Some(installation) = Installation::find() else {
        return;
    };
    let mut compared = Vec::new();
    let ours = ours();
    for (name, hash) in &ours {
        // what rosidl makes of an action is in the action's file
        let file = match name.split_once("/action/") {
            Some((package, part)) => {
                format!("{package}/action/{}", part.split('_').next().unwrap())
            }
            None => name.clone(),
        };
        let Some(text) = installation.read(&file, "json") else {
            continue;
        };
        let file: serde_json::Value = serde_json::from_str(&text).unwrap();
        let theirs = file["type_hashes"]
            .as_array()
            .unwrap()
            .iter()
            .find(|entry| entry["type_name"] == name.as_str())
            .unwrap();
        assert_eq!(theirs["hash_string"], hash.as_str(), "{name}");
        compared.push(name);
    }
    eprintln!(
        "{} hashes of {} are those of the installation",
        compared.len(),
        ours.len()
    );
    assert!(!compared.is_empty(), "it has none of our types");
    if std::env::var_os("CI").is_some() {
        let of_package = |name: &&String| name.starts_with("wm_msgs/");
        assert_eq!(
            compared.into_iter().filter(of_package).count(),
            ours.keys().filter(of_package).count(),
            "in CI, wm_msgs is built by the real rosidl, and held against it whole"
        );
    }
}
