//! `wm keys`: Zenoh with TLS and access rules, with the generated files alone.

use crate::harness::{Process, WM, bundled_bag, root, wait_until, whole_suite, wm, wm_node};
use std::{
    net::UdpSocket,
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
    process::{Command, Output},
    time::Duration,
};
use zenoh::{Config, Session, handlers::RingChannel, sample::Locality};

/// Far longer than anything here takes; only ends a hanging test.
const PATIENCE: Duration = Duration::from_secs(30);
/// A refused session does not retry.
const AT_ONCE: &str = "0";
/// Zenoh's listener pauses for 0.1 s after each refused handshake, so many are tried on many ports.
const PORTS: usize = 16;
const STRANGERS: usize = 1000;
/// How often a router is started if one of its ports is taken meanwhile.
const ATTEMPTS: usize = 5;

const DOMAIN: u16 = 7;
const PLAN: &str = "7/wm/plan/wm_msgs::msg::dds_::Plan_/RIHS01_00";
const PLAN_OF_VIEW: &str = "7/wm/action_chunk/wm_msgs::msg::dds_::ActionChunk_/RIHS01_00";

/// `wm keys` in a new folder.
struct Keys {
    folder: tempfile::TempDir,
    port: u16,
}

fn keys(folder: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(WM);
    command
        .arg("keys")
        .arg(folder)
        .args(args)
        .current_dir(root());
    command.output().unwrap()
}

/// So many different ports that are free now.
fn free_ports(count: usize) -> Vec<u16> {
    let sockets = (0..count).map(|_| UdpSocket::bind("127.0.0.1:0").unwrap());
    // All are held at once: the system may give a port that was let go a second time.
    let sockets: Vec<_> = sockets.collect();
    let ports = sockets
        .iter()
        .map(|socket| socket.local_addr().unwrap().port());
    ports.collect()
}

impl Keys {
    fn new(args: &[&str]) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let port = free_ports(1)[0];
        let (domain, port_text) = (DOMAIN.to_string(), port.to_string());
        let own = ["--domain", &domain, "--port", &port_text];
        let output = keys(&folder.path().join("keys"), &[&own, args].concat());
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{errors}");
        Self { folder, port }
    }

    fn file(&self, name: &str) -> PathBuf {
        self.folder.path().join("keys").join(name)
    }

    fn config(&self, name: &str) -> Config {
        Config::from_file(self.file(name)).unwrap()
    }

    /// The router, which listens on so many further ports too, and these ports.
    async fn router(&self, further: usize) -> (Session, Vec<u16>) {
        for attempt in 1..=ATTEMPTS {
            let further = free_ports(further);
            let mut config = self.config("router.json5");
            let ports = [&[self.port][..], &further].concat();
            let endpoints = ports.iter().map(|port| endpoint(*port));
            let endpoints = serde_json::to_string(&endpoints.collect::<Vec<_>>()).unwrap();
            config.insert_json5("listen/endpoints", &endpoints).unwrap();
            match zenoh::open(config).await {
                Ok(session) => return (session, further),
                // Another test's socket was given one of the ports meanwhile.
                Err(error) if attempt < ATTEMPTS && error.to_string().contains("in use") => {}
                Err(error) => panic!("{error}"),
            }
        }
        unreachable!("the last attempt returns or panics")
    }

    async fn session(&self, name: &str) -> Session {
        let opened = tokio::time::timeout(PATIENCE, zenoh::open(self.config(name))).await;
        opened.unwrap().unwrap()
    }
}

fn endpoint(port: u16) -> String {
    format!("quic/127.0.0.1:{port}")
}

/// A configuration that connects to this port only, and only once.
fn at_once(mut config: Config, port: u16) -> Config {
    let endpoints = format!("[{:?}]", endpoint(port));
    config
        .insert_json5("connect/endpoints", &endpoints)
        .unwrap();
    config.insert_json5("connect/timeout_ms", AT_ONCE).unwrap();
    config
}

/// Opens sessions one after the other; returns how many were refused.
async fn refused(config: Config, count: usize) -> usize {
    let mut refused = 0;
    for _ in 0..count {
        let opened = tokio::time::timeout(PATIENCE, zenoh::open(config.clone())).await;
        refused += usize::from(opened.expect("an answer").is_err());
    }
    refused
}

/// The configuration of a session with the authority's certificate, but none of its own.
fn stranger(keys: &Keys) -> Config {
    let authority = keys.file("authority.pem");
    let text = serde_json::json!({
        "mode": "client",
        "scouting": {"multicast": {"enabled": false}},
        "connect": {"exit_on_failure": true},
        "transport": {"link": {"tls": {"root_ca_certificate": authority}}},
    });
    Config::from_json5(&text.to_string()).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn stranger_without_certificate_is_always_refused() {
    let keys = Keys::new(&[]);
    let (_router, ports) = keys.router(PORTS).await;
    let stranger = stranger(&keys);
    let tries = ports.iter().map(|port| {
        let config = at_once(stranger.clone(), *port);
        tokio::spawn(refused(config, STRANGERS.div_ceil(PORTS)))
    });
    let tries: Vec<_> = tries.collect();
    let mut count = 0;
    for refused in tries {
        count += refused.await.unwrap();
    }
    assert_eq!(count, STRANGERS.div_ceil(PORTS) * PORTS);
    // each port is open to a certificate, and was so all the time
    for port in ports {
        let config = at_once(keys.config("wm.view.json5"), port);
        let admitted = tokio::time::timeout(PATIENCE, zenoh::open(config)).await;
        admitted.unwrap().unwrap().close().await.unwrap();
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn certificate_of_another_authority_is_refused_both_ways() {
    let (keys, others) = (Keys::new(&[]), Keys::new(&[]));
    let _router = keys.router(0).await;
    let config = at_once(others.config("wm.view.json5"), keys.port);
    assert_eq!(refused(config, 3).await, 3);

    // it trusts this router, but its own certificate is of another authority
    let mut config = at_once(others.config("wm.view.json5"), keys.port);
    let root = std::fs::read_to_string(keys.file("authority.pem")).unwrap();
    let trusted = base64_of(&root);
    config
        .insert_json5(
            "transport/link/tls/root_ca_certificate_base64",
            &format!("{trusted:?}"),
        )
        .unwrap();
    assert_eq!(refused(config, 3).await, 3);
    keys.session("wm.view.json5").await.close().await.unwrap();
}

fn base64_of(text: &str) -> String {
    use base64::Engine as _;
    base64::engine::general_purpose::STANDARD.encode(text)
}

/// A node's certificate does not pass for the router's.
#[tokio::test(flavor = "multi_thread")]
async fn session_certificate_is_refused_as_a_router() {
    let keys = Keys::new(&[]);
    let text = std::fs::read_to_string(keys.file("wm.view.json5")).unwrap();
    let text = text.replace("connect_certificate_base64", "listen_certificate_base64");
    let text = text.replace("connect_private_key_base64", "listen_private_key_base64");
    let mut config = Config::from_json5(&text).unwrap();
    config.insert_json5("mode", "'router'").unwrap();
    config.insert_json5("connect/endpoints", "[]").unwrap();
    let endpoints = format!("[{:?}]", endpoint(keys.port));
    config.insert_json5("listen/endpoints", &endpoints).unwrap();
    let _false_router = zenoh::open(config).await.unwrap();
    let planner = at_once(keys.config("wm.planner.json5"), keys.port);
    assert_eq!(refused(planner, 3).await, 3);
}

#[tokio::test(flavor = "multi_thread")]
async fn certificate_limits_what_its_holder_may_do() {
    let keys = Keys::new(&["--tool", "desk=read"]);
    let _router = keys.router(0).await;
    let planner = keys.session("wm.planner.json5").await;
    let view = keys.session("wm.view.json5").await;
    let executor = keys.session("wm.executor.json5").await;
    let plans = executor.declare_subscriber(PLAN).await.unwrap();
    let chunks = executor.declare_subscriber(PLAN_OF_VIEW).await.unwrap();
    let desk = keys.session("desk.json5").await;
    let everything = desk.declare_subscriber("7/**");
    let everything = everything.allowed_origin(Locality::Remote).await.unwrap();

    let arrives = async |session: &Session, key: &str, text: &str| {
        let subscriber = if key == PLAN { &plans } else { &chunks };
        let start = std::time::Instant::now();
        loop {
            session.put(key, text).await.unwrap();
            let received =
                tokio::time::timeout(Duration::from_millis(100), subscriber.recv_async());
            if let Ok(sample) = received.await {
                return sample
                    .unwrap()
                    .payload()
                    .try_to_string()
                    .unwrap()
                    .into_owned();
            }
            assert!(start.elapsed() < PATIENCE, "{key} never arrives");
        }
    };
    assert_eq!(arrives(&planner, PLAN, "planned").await, "planned");
    // the view has the right to chunks, and these come after its plans on the same link
    for number in 0..10 {
        let text = format!("forged {number}");
        view.put(PLAN, &text).await.unwrap();
        desk.put(PLAN, &text).await.unwrap();
        arrives(&view, PLAN_OF_VIEW, "chosen").await;
    }
    while let Ok(Some(sample)) = plans.try_recv() {
        assert_eq!(sample.payload().try_to_string().unwrap(), "planned");
    }
    let received = everything.try_recv().unwrap();
    assert!(
        received.is_none(),
        "topics are read one by one: {received:?}"
    );
}

#[test]
fn existing_keys_are_kept_and_new_ones_may_have_the_same_authority() {
    let first = Keys::new(&["--only", "encoder"]);
    let folder = first.folder.path().join("keys");
    let before = std::fs::read(first.file("wm.encoder.json5")).unwrap();
    let again = keys(&folder, &[]);
    let errors = String::from_utf8_lossy(&again.stderr);
    assert_eq!(again.status.code(), Some(1), "{errors}");
    assert!(
        errors.contains("wm.encoder.json5") && errors.contains("--authority"),
        "{errors}"
    );
    assert_eq!(
        std::fs::read(first.file("wm.encoder.json5")).unwrap(),
        before
    );
    for name in std::fs::read_dir(&folder).unwrap() {
        let mode = name.unwrap().metadata().unwrap().permissions().mode();
        assert_eq!(mode & 0o777, 0o600);
    }

    let second = Keys::new(&["--authority", &folder.to_string_lossy()]);
    let pem = |keys: &Keys| std::fs::read(keys.file("authority.pem")).unwrap();
    assert_eq!(pem(&first), pem(&second));
}

/// `wm zenoh-router` with the generated file, and its log so far.
struct Router(Process);

impl Router {
    fn start(keys: &Keys) -> Self {
        let mut command = Command::new(WM);
        command.arg("zenoh-router");
        command.env("ZENOH_ROUTER_CONFIG_URI", keys.file("router.json5"));
        Self(Process::start(command))
    }

    fn log(&self) -> String {
        self.0.stderr()
    }

    fn denials(&self) -> Vec<String> {
        let log = self.log();
        let denials = log.lines().filter(|line| line.contains("access denied"));
        denials.map(str::to_owned).collect()
    }
}

/// A node of the suite with its session file alone.
fn node(keys: &Keys, name: &str, parameters: &[&str]) -> Process {
    let mut command = wm_node(DOMAIN, name, parameters);
    command.env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp");
    command.env(
        "ZENOH_SESSION_CONFIG_URI",
        keys.file(&format!("wm.{name}.json5")),
    );
    // security is enforced: the files alone satisfy it
    command.env("ROS_SECURITY_ENABLE", "true");
    command.env("ROS_SECURITY_STRATEGY", "Enforce");
    Process::start(command)
}

#[tokio::test(flavor = "multi_thread")]
async fn forbidden_message_is_logged_with_certificate_and_key() {
    let keys = Keys::new(&["--only", "view,planner"]);
    let router = Router::start(&keys);
    let view = keys.session("wm.view.json5").await;
    view.put(PLAN, "forged").await.unwrap();
    let expected = format!("access denied: /wm/view may not publish {PLAN}");
    wait_until("the denial is logged", PATIENCE, || {
        router
            .denials()
            .iter()
            .any(|line| line.starts_with("[WARN]") && line.ends_with(&expected))
    });
    let _everything = view.declare_subscriber("7/**").await.unwrap();
    let expected = "access denied: /wm/view may not subscribe to 7/**";
    wait_until("the wildcard is logged", PATIENCE, || {
        router.log().contains(expected)
    });
}

#[test]
fn whole_suite_predicts_with_the_generated_files_alone() {
    let _alone = whole_suite();
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build();
    runtime.unwrap().block_on(predict_with_generated_files());
}

/// The observer is a tool that may read: a session of this test.
async fn predict_with_generated_files() {
    let bag = bundled_bag();
    let bag = bag.to_str().unwrap();
    let of_player = format!("player:bag:={bag}");
    let mut args = vec!["--tool", "desk=read", "--ros-args", "-p", &of_player];
    args.extend(["-p", "player:goal:=true"]);
    let keys = Keys::new(&args);
    let router = Router::start(&keys);
    let desk = keys.session("desk.json5").await;
    let topics = [
        "wm/latent",
        "wm/predicted",
        "wm/predicted/image/compressed",
        "wm/plan",
    ];
    let mut subscribers = Vec::new();
    for topic in topics {
        let key = format!("{DOMAIN}/{topic}/*/*");
        // Zenoh's default channel blocks the session once it is full.
        let newest = RingChannel::new(1);
        let subscriber = desk.declare_subscriber(key).with(newest);
        subscribers.push((topic, subscriber.await.unwrap()));
    }
    let names = ["encoder", "predictor", "decoder", "planner"];
    let mut nodes: Vec<_> = names.iter().map(|name| node(&keys, name, &[])).collect();
    nodes.push(node(
        &keys,
        "player",
        &[&format!("bag:={bag}"), "loop:=true", "goal:=true"],
    ));
    for (topic, subscriber) in &subscribers {
        let received = tokio::time::timeout(2 * PATIENCE, subscriber.recv_async()).await;
        received
            .unwrap_or_else(|_| panic!("nothing on {topic}; {:?}", router.denials()))
            .unwrap();
    }
    assert_eq!(router.denials(), Vec::<String>::new());
}

#[test]
fn launch_with_keys_runs_the_main_job() {
    let _alone = whole_suite();
    let file = root().join("launch-configs/replay.launch.yaml");
    let file = file.to_str().unwrap();
    let keys = Keys::new(&["--launch", file]);
    let router = Router::start(&keys);
    let output = keys.folder.path().join("out");
    let folder = keys.folder.path().join("keys");
    let mut launch = wm(
        DOMAIN,
        &[
            "launch",
            file,
            &format!("output:={}", output.display()),
            "--keys",
            folder.to_str().unwrap(),
        ],
    );
    launch.env_remove("RMW_IMPLEMENTATION");
    launch.env("ROS_SECURITY_ENABLE", "true");
    launch.env("ROS_SECURITY_STRATEGY", "Enforce");
    let (status, log) = Process::start(launch).finish(4 * PATIENCE);
    assert!(status.success(), "{log}\n{:?}", router.denials());
    assert_eq!(router.denials(), Vec::<String>::new());
    assert!(output.join("report.json").exists());
    assert!(output.join("bag/metadata.yaml").exists());
}
