//! The ROS packages: `wm_nodes` is built by the real colcon over `wm_msgs`, which `tests/setup_ros2` built the same
//! way, and the overlay is used as by a ROS user.
//!
//! ros2cli and launch are not on PyPI, so `ros2 run`, `ros2 launch` and `ros2 interface` do not run here. Instead, the
//! tests look up the same entries through the real ament index, and start the same programs.

use std::{
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use serde_json::{Value, json};

use crate::harness::{
    Process, Signal, WM, fresh_domain, in_domain, peers, rclpy, root, ros2_env, whole_suite,
};

/// The nodes from the program's list.
fn nodes_of_wm() -> Vec<String> {
    let list = Command::new(WM).arg("nodes").output().expect("wm runs");
    let list = String::from_utf8(list.stdout).expect("UTF-8");
    let names = list.lines().filter_map(|line| line.split(' ').next());
    names.map(str::to_owned).collect()
}

/// Runs a bash `script` after sourcing `setup`; returns its stdout.
fn shell(setup: &Path, script: &str, args: &[&Path]) -> String {
    let mut command = Command::new("bash");
    command
        .args(["-c", &format!("set -e; . \"$0\"; {script}")])
        .arg(setup)
        .args(args)
        .env_remove("AMENT_PREFIX_PATH")
        .env_remove("CMAKE_PREFIX_PATH");
    let run = command.output().expect("bash runs");
    assert!(
        run.status.success(),
        "{script}: {}\n{}{}",
        run.status,
        String::from_utf8_lossy(&run.stdout),
        String::from_utf8_lossy(&run.stderr)
    );
    String::from_utf8(run.stdout).expect("UTF-8")
}

/// Builds `wm_nodes` below `workspace` around the binary under test; returns the overlay's install folder.
fn colcon_build(peers: &Path, workspace: &Path, options: &str) -> PathBuf {
    let script = format!(
        "cd \"$1\" && colcon --log-base log build --base-paths \"$2\" --packages-select wm_nodes {options} \
         --event-handlers console_direct+ --cmake-args -GNinja \"-DWM_BINARY=$3\""
    );
    let args = [workspace, &root().canonicalize().unwrap(), Path::new(WM)];
    shell(&ros2_env(peers), &script, &args);
    workspace.join("install")
}

fn path(value: &Value) -> &Path {
    Path::new(value.as_str().expect("a path"))
}

/// The contents of the overlay `install` by package.
fn look_up(peers: &Path, install: &Path) -> Value {
    let script = ". \"$1/local_setup.bash\" && python \"$2\" \"$3/msgs/package.xml\" \"$3/nodes/package.xml\"";
    let program = root().join("tests/interop/overlay.py");
    let args = [install, &program, root()];
    let answer = shell(&ros2_env(peers), script, &args);
    serde_json::from_str(&answer).expect("overlay.py prints JSON")
}

#[test]
fn colcon_finds_two_packages() {
    let Some(peers) = peers() else { return };
    let setup = ros2_env(&peers);
    let script = "colcon --log-base /dev/null list --base-paths \"$1\" --names-only";
    let names = shell(&setup, script, &[root()]);
    assert_eq!(
        names.lines().collect::<Vec<_>>(),
        ["wm_msgs", "wm_nodes"],
        "nothing else in the repository is taken for a package"
    );
}

#[test]
fn overlay_has_the_entries_that_ros_commands_look_up() {
    let Some(peers) = peers() else { return };
    let workspace = tempfile::tempdir().expect("a temporary directory");
    let workspace = workspace.path().canonicalize().unwrap();
    let install = colcon_build(&peers, &workspace, "");
    let overlay = look_up(&peers, &install);
    for (name, package) in overlay.as_object().expect("packages") {
        assert_eq!(package["warnings"], json!([]), "{name}/package.xml");
        assert_eq!(package["licenses"], json!(["MIT", "Apache-2.0"]), "{name}");
        assert_eq!(package["build_type"], "ament_cmake", "{name}");
        assert_eq!(package["version"], env!("CARGO_PKG_VERSION"), "{name}");
    }

    let messages = &overlay["wm_msgs"]["interfaces"];
    let mut files = Vec::new();
    for folder in ["action", "msg", "srv"] {
        for entry in std::fs::read_dir(root().join("msgs").join(folder)).unwrap() {
            let entry = entry.unwrap();
            let name = format!("{folder}/{}", entry.file_name().to_string_lossy());
            let text = std::fs::read_to_string(entry.path()).unwrap();
            assert_eq!(messages[&name], json!(text), "{name}");
            files.push(name);
        }
    }
    assert!(files.contains(&"msg/Prediction.msg".to_owned()));
    assert_eq!(messages.as_object().expect("files").len(), files.len());

    let nodes = &overlay["wm_nodes"];
    assert_eq!(path(&nodes["prefix"]), install.join("wm_nodes"));
    let executables = nodes["executables"].as_object().expect("executables");
    let names = nodes_of_wm();
    for name in &names {
        let help = Command::new(path(&executables[name]))
            .arg("--help")
            .output();
        let help = String::from_utf8(help.unwrap().stdout).unwrap();
        assert!(
            help.contains(&format!("Usage: wm {name}")),
            "{name}: {help}"
        );
    }
    assert_eq!(
        executables.len(),
        names.len() + 1,
        "one link for each node of `wm nodes`, and wm: {executables:?}"
    );
    let replay = &nodes["launch"]["replay.launch.yaml"][0]["path"];
    for name in ["replay.launch.py", "replay.launch.xml", "live.launch.yaml"] {
        let found = nodes["launch"][name].as_array().expect("a launch file");
        assert_eq!(
            found.len(),
            1,
            "`ros2 launch` refuses two of one name: {name}"
        );
    }
    let included = &nodes["launch"]["replay.launch.xml"][0]["includes"];
    assert_eq!(included, &json!([replay]));

    // the installed file's relative paths, from an unrelated folder, with the installed launcher
    let launch = Command::new(path(&executables["wm"]))
        .args(["launch", "--print-description"])
        .arg(path(replay))
        .current_dir(std::env::temp_dir())
        .output()
        .unwrap();
    let commands = String::from_utf8(launch.stdout).unwrap();
    let words: Vec<&str> = commands.split_whitespace().collect();
    let settings = words.windows(2).filter(|pair| pair[0] == "--params-file");
    let settings: Vec<&Path> = settings.map(|pair| Path::new(pair[1])).collect();
    // a replay has seven nodes, no evaluator and no env; its own settings follow the defaults of player and recorder
    let of_job = |path: &&&Path| path.ends_with("jobs.yaml");
    assert_eq!(settings.iter().filter(of_job).count(), 2, "{commands}");
    assert_eq!(settings.len(), 7 + 2, "{commands}");
    let bag = words.iter().find_map(|word| word.split_once("bag:="));
    let (_, bag) = bag.expect("the player is given a bag");
    let bag = Path::new(bag.trim_matches(['"', '\'']));
    for file in settings.iter().chain([&bag]) {
        assert!(
            file.starts_with(install.join("wm_nodes")),
            "{}",
            file.display()
        );
        assert!(file.exists(), "{} is installed", file.display());
    }
}

/// The command line that launch_ros makes of the encoder's entry in `replay.launch.yaml`.
#[test]
fn installed_node_starts_with_ros_2_launchs_command() {
    let Some(peers) = peers() else { return };
    let _alone = whole_suite();
    let domain = fresh_domain();
    let workspace = tempfile::tempdir().expect("a temporary directory");
    let workspace = workspace.path().canonicalize().unwrap();
    let nodes = colcon_build(&peers, &workspace, "--symlink-install").join("wm_nodes");
    // the file that launch_ros writes for a parameter in the launch file
    let given = workspace.join("launch_params");
    std::fs::write(&given, "/**:\n  ros__parameters:\n    dtype: f32\n").unwrap();
    let mut command = Command::new(nodes.join("lib/wm_nodes/encoder"));
    command
        .current_dir(&workspace)
        .args(["--ros-args", "-r", "__node:=encoder", "--params-file"])
        .arg(nodes.join("share/wm_nodes/launch/config/encoder.yaml"))
        .arg("--params-file")
        .arg(&given);
    in_domain(&mut command, domain);
    let encoder = Process::start(command);

    let args = ["--seconds", "20", "/wm/encoder"];
    let peer = Process::start(rclpy(&peers, domain, "parameters.py", &args));
    let (status, stdout) = peer.finish(Duration::from_secs(60));
    assert!(status.success(), "parameters.py: {status}");
    let answer: Value = serde_json::from_str(&stdout).expect("parameters.py prints JSON");
    let dtype = &answer["parameters"]["dtype"]["value"];
    assert_eq!(dtype, "f32", "the later file wins over encoder.yaml");
    encoder.signal(Signal::INT);
    let (status, _) = encoder.finish(Duration::from_secs(30));
    assert!(status.success(), "{status}");
}
