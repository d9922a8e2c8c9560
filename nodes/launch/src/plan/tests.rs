use super::*;
use std::collections::BTreeMap;

/// Files and environment in memory.
#[derive(Default)]
struct Memory {
    files: BTreeMap<&'static str, &'static str>,
    environment: BTreeMap<&'static str, &'static str>,
}

impl Surroundings for Memory {
    fn environment(&self, name: &str) -> Option<String> {
        self.environment.get(name).map(|value| (*value).to_owned())
    }
    fn read(&self, path: &Path) -> std::io::Result<String> {
        let text = self.files.get(path.to_str().unwrap());
        text.map(|text| (*text).to_owned())
            .ok_or_else(|| std::io::ErrorKind::NotFound.into())
    }
    fn exists(&self, path: &Path) -> bool {
        self.files
            .keys()
            .any(|file| Path::new(file).starts_with(path))
    }
}

fn resolve_in(
    memory: &Memory,
    text: &str,
    arguments: &[(&str, &str)],
) -> Result<Plan, LaunchError> {
    let file = LaunchFile::parse(Path::new("/l/x.launch.yaml"), text)?;
    let arguments = arguments
        .iter()
        .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
        .collect();
    Plan::resolve(&file, &arguments, memory)
}

fn resolve(text: &str, arguments: &[(&str, &str)]) -> Result<Plan, LaunchError> {
    resolve_in(&Memory::default(), text, arguments)
}

fn message(text: &str, arguments: &[(&str, &str)]) -> String {
    format!(
        "{:#}",
        anyhow::Error::from(resolve(text, arguments).unwrap_err())
    )
}

#[test]
fn node_becomes_a_command_line() {
    let text = r#"
launch:
- arg: {name: rate, default: "1.5"}
- arg: {name: bag, default: "$(dirname)/b"}
- let: {name: out, value: "out/$(var bag)"}
- node:
    pkg: wm_nodes
    exec: player
    name: play
    namespace: wm
    args: "--verbose 'two words'"
    ros_args: "--log-level info"
    on_exit: shutdown
    launch-prefix: "nice -n 10"
    output: screen
    param:
    - {name: rate, value: "$(var rate)"}
    - {name: text, value: "$(var rate)", type: str}
    - {name: plain, value: "1.5"}
    - {name: whole, value: 2.0}
    - {name: list, value: [1, 2]}
    - {name: words, value: ["$(var rate)", "$(var bag)"], type: list_of_str}
    - {name: precise, value: "$(var rate)", type: float}
    - {name: bag, value: "$(var out)"}
    remap:
    - {from: /a, to: "/b/$(var rate)"}
"#;
    let plan = resolve(text, &[("rate", "2")]).unwrap();
    let process = &plan.processes[0];
    assert_eq!(process.name, "play-1");
    assert_eq!(process.node.as_deref(), Some("/wm/play"));
    assert!(process.ends_launch);
    assert_eq!(process.prefix, ["nice", "-n", "10"]);
    assert_eq!(process.program, Program::Own);
    assert_eq!(process.output, Output::Screen);
    assert_eq!(process.respawn, None);
    let expected = [
        "player",
        "--verbose",
        "two words",
        "--ros-args",
        "--log-level",
        "info",
        "-r",
        "__node:=play",
        "-r",
        "__ns:=/wm",
        "-p",
        "rate:=2",
        "-p",
        "text:=\"2\"",
        "-p",
        "plain:=\"1.5\"",
        "-p",
        "whole:=2.0",
        "-p",
        "list:=[1, 2]",
        "-p",
        "words:=[\"2\", \"/l/b\"]",
        "-p",
        "precise:=2.0",
        "-p",
        "bag:=\"out//l/b\"",
        "-r",
        "/a:=/b/2",
    ];
    assert_eq!(process.arguments, expected);
}

#[test]
fn conditions_and_scopes_hold() {
    let text = r#"
launch:
- arg: {name: on, default: "true"}
- group:
  - push_ros_namespace: {namespace: robot}
  - set_env: {name: A, value: "1"}
  - let: {name: on, value: "false"}
  - node: {pkg: wm_nodes, exec: encoder, namespace: wm}
  - node: {pkg: wm_nodes, exec: decoder, namespace: /abs, unless: "$(var on)"}
  - node: {pkg: wm_nodes, exec: planner, if: "$(var on)"}
- node: {pkg: wm_nodes, exec: monitor, if: "$(var on)"}
"#;
    let plan = resolve(text, &[]).unwrap();
    let names: Vec<_> = plan
        .processes
        .iter()
        .map(|process| process.name.as_str())
        .collect();
    assert_eq!(names, ["encoder-1", "decoder-2", "monitor-3"]);
    assert!(
        plan.processes[0]
            .arguments
            .contains(&"__ns:=/robot/wm".to_owned())
    );
    assert!(
        plan.processes[1]
            .arguments
            .contains(&"__ns:=/abs".to_owned())
    );
    assert_eq!(
        plan.processes[0].environment,
        [("A".to_owned(), Some("1".to_owned()))]
    );
    assert!(plan.processes[2].environment.is_empty());
}

#[test]
fn executables_and_respawn() {
    let text = "launch:\n- executable: {cmd: 'sleep $(env N 10)', respawn: true, respawn_delay: 0.5, respawn_max_retries: 2, sigterm_timeout: 1}";
    let plan = resolve(text, &[]).unwrap();
    let process = &plan.processes[0];
    assert_eq!(
        (process.name.as_str(), process.arguments.as_slice()),
        ("sleep-1", &["10".to_owned()][..])
    );
    let respawn = process.respawn.unwrap();
    assert_eq!(
        (respawn.delay.as_millis(), respawn.max_retries),
        (500, Some(2))
    );
    assert_eq!(process.sigterm_timeout.as_secs(), 1);
}

#[test]
fn other_packages_are_found_by_their_prefix() {
    let memory = Memory {
        files: [
            ("/opt/ros/share/cam/package.xml", ""),
            ("/opt/ros/lib/cam/driver", ""),
        ]
        .into(),
        environment: [("AMENT_PREFIX_PATH", "/nowhere:/opt/ros")].into(),
    };
    let plan = resolve_in(&memory, "launch:\n- node: {pkg: cam, exec: driver}", &[]).unwrap();
    assert_eq!(
        plan.processes[0].program,
        Program::Path("/opt/ros/lib/cam/driver".into())
    );
    let missing = resolve_in(&memory, "launch:\n- node: {pkg: cam, exec: other}", &[])
        .unwrap_err()
        .to_string();
    assert!(
        missing.contains("/opt/ros/lib/cam/other is missing"),
        "{missing}"
    );
    assert!(
        message("launch:\n- node: {pkg: cam, exec: driver}", &[]).contains("AMENT_PREFIX_PATH")
    );
}

#[test]
fn included_file_receives_its_arguments() {
    let memory = Memory {
        files: [
            (
                "/l/y.launch.yaml",
                "launch:\n- arg: {name: n}\n- node: {pkg: wm_nodes, exec: '$(var n)'}",
            ),
            (
                "/l/loop.launch.yaml",
                "launch:\n- include: {file: /l/loop.launch.yaml}",
            ),
        ]
        .into(),
        ..Memory::default()
    };
    let text =
        "launch:\n- include: {file: $(dirname)/y.launch.yaml, arg: [{name: n, value: encoder}]}";
    assert_eq!(
        resolve_in(&memory, text, &[]).unwrap().processes[0].name,
        "encoder-1"
    );
    let looping = resolve_in(
        &memory,
        "launch:\n- include: {file: /l/loop.launch.yaml}",
        &[],
    );
    assert!(
        looping
            .unwrap_err()
            .to_string()
            .contains("include each other")
    );
}

#[test]
fn wrong_arguments_are_named() {
    let text = "launch:\n- arg: {name: bag, description: the bag}\n- arg: {name: mode, default: a, choice: [{value: a}, {value: b}]}";
    assert!(message(text, &[]).contains("bag:=VALUE"));
    assert!(message(text, &[("bag", "x"), ("mode", "c")]).contains("expected one of: a, b"));
    assert!(message(text, &[("bag", "x"), ("bgg", "y")]).contains("\"bgg\" is not declared"));
    assert!(
        message("launch:\n- let: {name: a, value: $(var b)}", &[])
            .contains("launch variable \"b\"")
    );
    assert!(
        message("launch:\n- let: {name: a, value: b, if: maybe}", &[])
            .contains("true, false, 1 or 0")
    );
    let file = "launch:\n- node: {pkg: wm_nodes, exec: e, param: [{from: /no.yaml}]}";
    assert!(message(file, &[]).contains("/no.yaml"));
    let output = "launch:\n- node: {pkg: wm_nodes, exec: e, output: console}";
    assert!(message(output, &[]).contains("screen, log or both"));
}

#[test]
fn two_nodes_of_one_name_cause_a_warning() {
    let node = "- node: {pkg: wm_nodes, exec: encoder, name: a}\n";
    let plan = resolve(&format!("launch:\n{node}{node}"), &[]).unwrap();
    assert_eq!(plan.warnings, ["more than one node is named /a"]);
}

/// The arguments of a process of a launch file of the repository.
fn arguments_of(file: &str, name: &str, arguments: &[(&str, &str)]) -> Option<String> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../launch-configs");
    let path = folder.join(file);
    let text = std::fs::read_to_string(&path).unwrap();
    let file = LaunchFile::parse(&path, &text).unwrap();
    let arguments = arguments
        .iter()
        .map(|(name, value)| ((*name).to_owned(), (*value).to_owned()))
        .collect();
    let plan = Plan::resolve(&file, &arguments, &System).unwrap();
    let mut processes = plan.processes.into_iter();
    let process = processes.find(|process| process.arguments.first().is_some_and(|n| n == name))?;
    Some(process.arguments.join(" "))
}

#[test]
fn several_cameras_are_joined_for_all_nodes() {
    let cameras = [("cameras", "[/front/image_raw, /wrist/image_raw]")];
    for file in ["live.launch.yaml", "replay.launch.yaml"] {
        let views = arguments_of(file, "views", &cameras).unwrap();
        let expected = r#"-p cameras:=["/front/image_raw", "/wrist/image_raw"]"#;
        assert!(views.contains(expected), "{views}");
        for (node, expected) in [
            ("encoder", "-r /camera/image_raw:=/wm/views/image_raw"),
            ("monitor", "-p camera_topic:=\"/wm/views/image_raw\""),
        ] {
            let found = arguments_of(file, node, &cameras).unwrap();
            assert!(found.contains(expected), "{found}");
            let single = arguments_of(file, node, &[]).unwrap();
            assert!(!single.contains("/wm/views/"), "{single}");
        }
        assert_eq!(arguments_of(file, "views", &[]), None);
    }
    // One camera's last frame is no goal for several.
    let player = |arguments: &[_]| arguments_of("replay.launch.yaml", "player", arguments).unwrap();
    assert!(player(&cameras).contains("-p goal:=false"));
    assert!(player(&[]).contains("-p goal:=true"));
}
