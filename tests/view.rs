//! The page of `wm view`, in a real browser; and clients that are slow, many or hostile.

use std::{
    collections::BTreeSet,
    io::Read as _,
    net::TcpListener,
    path::PathBuf,
    time::{Duration, Instant},
};

use serde_json::{Value, json};

use crate::{
    browser::Browser,
    harness::{Process, Signal, bundled_bag, fresh_domain, resident, wait_until, whole_suite, wm},
    websocket::{Message, Socket, open, request},
};

/// Far above what anything here takes; it only ends a test that hangs.
const PATIENCE: Duration = Duration::from_secs(120);

/// A port that is free.
fn free_port() -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a port");
    listener.local_addr().expect("an address").port()
}

/// A running view, once its page is served.
struct View {
    port: u16,
    process: Process,
}

impl View {
    fn start(domain: u16, port: u16, args: &[&str]) -> Self {
        let port_text = port.to_string();
        let all = [&["view", "--port", &port_text], args].concat();
        let process = Process::start(wm(domain, &all));
        wait_until("the page is served", PATIENCE, || {
            std::net::TcpStream::connect(("127.0.0.1", port)).is_ok()
        });
        Self { port, process }
    }

    fn url(&self) -> String {
        format!("http://127.0.0.1:{}/", self.port)
    }

    fn open(&self) -> Socket {
        let (status, socket) = open(self.port, &[]);
        socket.unwrap_or_else(|| panic!("the socket is refused with {status}"))
    }
}

/// A camera: the bundled bag, again and again, with stamps of now, at so many times its 5 Hz.
fn player(domain: u16, rate: &str) -> Process {
    let bag = bundled_bag();
    let bag = bag.to_string_lossy();
    let args = ["bag", "play", "--loop", "--restamp", "--rate", rate, &bag];
    Process::start(wm(domain, &args))
}

/// The body of what is served under a path.
fn body(port: u16, path: &str, headers: &[(&str, &str)]) -> (u16, Vec<u8>) {
    let (status, mut stream) = request(port, path, &[headers, &[("Connection", "close")]].concat());
    let mut body = Vec::new();
    stream.read_to_end(&mut body).expect("a body");
    (status, body)
}

/// Where pictures of the page are left for somebody to look at; nowhere, unless asked for.
fn gallery() -> Option<PathBuf> {
    std::env::var_os("WM_VIEW_SCREENSHOTS").map(PathBuf::from)
}

fn picture(browser: &mut Browser, name: &str) {
    if let Some(folder) = gallery() {
        browser.screenshot(&folder.join(format!("{name}.png")));
    }
}

/// How many colours there are on a panel's canvas, and whether the picture changed since the last call.
const COLOURS: &str = "((id) => {
    const canvas = document.querySelector(`#${id} canvas`);
    const pixels = canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data;
    const colours = new Set();
    for (let at = 0; at < pixels.length; at += 4) colours.add((pixels[at] << 16) | (pixels[at + 1] << 8) | pixels[at + 2]);
    return colours.size;
})";

fn colours(browser: &mut Browser, panel: &str) -> u64 {
    browser
        .evaluate(&format!("{COLOURS}('{panel}')"))
        .as_u64()
        .expect("a number")
}

fn text(browser: &mut Browser, selector: &str) -> String {
    let expression = format!("document.querySelector({}).innerText", json!(selector));
    browser
        .evaluate(&expression)
        .as_str()
        .unwrap_or_default()
        .to_owned()
}

#[test]
fn the_page_shows_the_main_job_live() {
    let _alone = whole_suite();
    let (domain, port) = (fresh_domain(), free_port());
    let out = tempfile::tempdir().expect("a temporary directory");
    let (output, view_port) = (
        format!("output:={}", out.path().display()),
        format!("view_port:={port}"),
    );
    let file = "launch-configs/replay.launch.yaml";
    let args = [
        "launch",
        file,
        &output,
        "loop:=true",
        "rate:=0.5",
        "view:=true",
        &view_port,
    ];
    let launch = Process::start(wm(domain, &args));
    wait_until("the page is served", PATIENCE, || {
        std::net::TcpStream::connect(("127.0.0.1", port)).is_ok()
    });
    let Some(mut browser) = Browser::open(&format!("http://127.0.0.1:{port}/")) else {
        launch.signal(Signal::INT);
        return;
    };
    browser.wait_for("document.body.dataset.state === 'live'", PATIENCE);
    browser.wait_for(
        "wmView.page.latencies.length > 3 && wmView.page.psnr > 15",
        PATIENCE,
    );
    for panel in ["camera", "predicted", "difference"] {
        assert!(colours(&mut browser, panel) > 100, "{panel}");
    }
    browser.wait_for(
        "wmView.record.errors.some((error) => error.k === 8)",
        PATIENCE,
    );
    browser.wait_for(
        "wmView.record.plans.length && wmView.record.outcomes.length && wmView.record.goals.length",
        PATIENCE,
    );
    browser.wait_for(
        "document.querySelectorAll('#nodes tbody tr').length >= 6",
        PATIENCE,
    );
    browser.wait_for("document.querySelector('#k').max === '8'", PATIENCE);
    // The wait says so where it fails: what is drawn a quarter of a second later.
    browser.wait_for(
        "document.querySelector('#plan-cost').innerText.startsWith('cost ')",
        PATIENCE,
    );
    browser.wait_for(
        "document.querySelector('#goal canvas').width > 100",
        PATIENCE,
    );
    picture(&mut browser, "live");
    let horizon = browser.evaluate("document.querySelectorAll('#strip button').length");
    assert_eq!(horizon, 8);

    // Another k is another picture.
    browser.press("4");
    browser.wait_for("wmView.page.shown('predicted')?.k === 4", PATIENCE);
    assert!(text(&mut browser, "#k-text").starts_with("k=4, 1.6 s"));

    // Paused, nothing moves; a step back is the frame before.
    browser.press(" ");
    browser.wait_for("document.body.dataset.state === 'paused'", PATIENCE);
    let at = "wmView.page.shown('camera').stamp";
    let first = browser.evaluate(at);
    let frames = browser.evaluate("wmView.record.frames.length").as_u64();
    browser.wait_for(
        &format!("wmView.record.frames.length > {} + 3", frames.unwrap_or(0)),
        PATIENCE,
    );
    assert_eq!(browser.evaluate(at), first);
    browser.press("ArrowLeft");
    browser.wait_for(&format!("{at} !== {first}"), PATIENCE);
    let back = browser.evaluate(&format!("(BigInt({first}) - BigInt({at})) / 1000000n + ''"));
    let back: i64 = back
        .as_str()
        .and_then(|text| text.parse().ok())
        .expect("milliseconds");
    // Frames are 0.2 s apart, at half the rate; on a busy machine one may be missing.
    assert!(back > 300 && (back + 100) % 400 < 200, "{back} ms");
    browser.press(",");
    browser.wait_for(
        "wmView.page.shown('predicted') && wmView.page.shown('predicted').k === 4",
        PATIENCE,
    );
    browser.wait_for(
        "document.querySelector('#difference .caption').innerText.includes('dB')",
        PATIENCE,
    );
    picture(&mut browser, "paused");
    browser.press("l");
    browser.wait_for("document.body.dataset.state === 'live'", PATIENCE);

    // On a phone, and at night.
    browser.size(390, 844);
    browser.prefer("dark");
    browser.wait_for("document.documentElement.scrollWidth <= 390", PATIENCE);
    picture(&mut browser, "phone");
    browser.size(1400, 1000);
    picture(&mut browser, "dark");

    // Without control, the page offers none, and the node takes none.
    assert_eq!(
        browser.evaluate("document.querySelector('#reset').hidden"),
        true
    );
    let refused = browser.evaluate(
        "new Promise((resolve) => { const socket = new WebSocket(`ws://${location.host}/socket`, ['wm.view.v1']);
         socket.onopen = () => socket.send(JSON.stringify({ number: 3, command: { op: 'reset' } }));
         socket.onmessage = ({ data }) => { if (typeof data === 'string' && data.includes('answer')) resolve(JSON.parse(data)); }; })",
    );
    assert_eq!(
        (&refused["number"], &refused["done"]),
        (&json!(3), &json!(false)),
        "{refused}"
    );

    launch.signal(Signal::INT);
    let (status, _) = launch.finish(PATIENCE);
    assert!(matches!(status.code(), Some(0 | 3)), "{status}");
    browser.wait_for("document.body.dataset.state === 'connecting'", PATIENCE);
}

#[test]
fn a_page_without_data_says_what_is_missing_and_finds_its_node_again() {
    let (domain, port) = (fresh_domain(), free_port());
    let view = View::start(domain, port, &[]);
    let Some(mut browser) = Browser::open(&view.url()) else {
        return;
    };
    browser.wait_for(
        "document.querySelector('#camera .missing').innerText.includes('/camera/image_raw')",
        PATIENCE,
    );
    let missing = text(&mut browser, "#predicted .missing");
    assert_eq!(missing, "no predictor is running");
    browser.wait_for(
        "document.querySelector('#error .missing').innerText !== ''",
        PATIENCE,
    );
    picture(&mut browser, "empty");

    let _player = player(domain, "1");
    browser.wait_for("wmView.page.latencies.length > 3", PATIENCE);
    assert!(colours(&mut browser, "camera") > 100);

    view.process.signal(Signal::INT);
    let (status, _) = view.process.finish(PATIENCE);
    assert!(status.success(), "{status}");
    browser.wait_for("document.body.dataset.state === 'connecting'", PATIENCE);
    let _again = View::start(domain, port, &[]);
    browser.evaluate("wmView.page.latencies.length = 0");
    browser.wait_for(
        "document.body.dataset.state === 'live' && wmView.page.latencies.length > 3",
        PATIENCE,
    );
}

#[test]
fn a_goal_is_set_from_a_frame_that_was_seen_where_that_is_permitted() {
    let domain = fresh_domain();
    let view = View::start(domain, free_port(), &["--control", "goals"]);
    let _player = player(domain, "1");
    let Some(mut browser) = Browser::open(&view.url()) else {
        return;
    };
    browser.wait_for("wmView.page.latencies.length > 3", PATIENCE);
    browser.press(" ");
    browser.press("g");
    browser.wait_for(
        "document.querySelector('#toast').innerText !== ''",
        PATIENCE,
    );
    browser.evaluate("(globalThis.seen = wmView.page.shown('camera')) !== undefined");
    // The view hears the goal as everybody does; a page that is paused shows the goal of its moment.
    browser.press("l");
    browser.wait_for("wmView.page.shown('goal')", PATIENCE);
    let goal = browser.evaluate(
        "(async () => { const get = async (label) => {
            const path = [label.source, label.stamp, label.observed, label.k].join('/');
            return Array.from(new Uint8Array(await (await fetch(`/picture/${path}`)).arrayBuffer())).join(); };
         return (await get(wmView.page.shown('goal'))) === (await get(globalThis.seen)); })()",
    );
    assert_eq!(goal, true);
    // Nobody is there to be reset, and it may not arm anything.
    let mut socket = view.open();
    socket.send(r#"{"number":1,"command":{"op":"arm","armed":true}}"#);
    let answer = socket.answer();
    assert_eq!(
        (&answer["number"], &answer["done"]),
        (&json!(1), &json!(false))
    );
    assert!(
        answer["text"]
            .as_str()
            .is_some_and(|text| text.contains("not permitted")),
        "{answer}"
    );
    socket.send(r#"{"number":2,"command":{"op":"reset"}}"#);
    let answer = socket.answer();
    let text = answer["text"].as_str().unwrap_or_default();
    assert!(
        answer["done"] == false && text.contains("/wm/predictor/reset is not there"),
        "{answer}"
    );
    socket.send(r#"{"number":3,"command":{"op":"stop"}}"#);
    let answer = socket.answer();
    assert!(
        answer["text"]
            .as_str()
            .is_some_and(|text| text.contains("no executor")),
        "{answer}"
    );
}

/// What the executor does, by the next status that tells of one and satisfies `is_so`.
fn executor_state(socket: &mut Socket, is_so: impl Fn(&str) -> bool) -> String {
    loop {
        match socket.receive() {
            Message::Text(text) if text["op"] == "status" => {
                match text["executor"]["state"].as_str() {
                    Some(state) if is_so(state) => return state.to_owned(),
                    _ => {}
                }
            }
            Message::Closed => panic!("the socket was closed"),
            _ => {}
        }
    }
}

#[test]
fn anybody_who_may_look_stops_the_executor_and_only_who_may_arms_it() {
    let domain = fresh_domain();
    let _executor = Process::start(wm(domain, &["executor"]));
    let looking = View::start(domain, free_port(), &[]);
    let arming = View::start(domain, free_port(), &["--control", "all"]);
    let (mut looker, mut armer) = (looking.open(), arming.open());
    let ask = |socket: &mut Socket, command: &str| {
        socket.send(&format!("{{\"number\":1,\"command\":{command}}}"));
        let answer = socket.answer();
        (
            answer["done"] == true,
            answer["text"].as_str().unwrap_or_default().to_owned(),
        )
    };
    let (arm, disarm) = (
        r#"{"op":"arm","armed":true}"#,
        r#"{"op":"arm","armed":false}"#,
    );
    let (stop, release) = (r#"{"op":"stop"}"#, r#"{"op":"release"}"#);
    for socket in [&mut looker, &mut armer] {
        assert_eq!(executor_state(socket, |_| true), "dry run");
    }
    for command in [arm, release] {
        let (is_done, text) = ask(&mut looker, command);
        assert!(!is_done && text.contains("not permitted"), "{text}");
    }
    assert!(ask(&mut armer, arm).0);
    executor_state(&mut looker, |state| state == "idle");
    let (is_done, text) = ask(&mut looker, stop);
    assert!(is_done, "{text}");
    executor_state(&mut looker, |state| state == "stopped");
    // It stays so until somebody who may says otherwise.
    assert!(!ask(&mut armer, arm).0);
    assert!(ask(&mut armer, release).0);
    executor_state(&mut looker, |state| state == "dry run");
    assert!(ask(&mut armer, arm).0);
    executor_state(&mut looker, |state| state == "idle");
    assert!(ask(&mut looker, disarm).0);
    executor_state(&mut looker, |state| state == "dry run");

    let Some(mut browser) = Browser::open(&arming.url()) else {
        return;
    };
    browser.wait_for(
        "!document.querySelector('#executor').hidden && !document.querySelector('#arm').hidden",
        PATIENCE,
    );
    browser.evaluate("document.querySelector('#arm').click()");
    browser.wait_for("document.querySelector('#arm-dialog').open", PATIENCE);
    picture(&mut browser, "arm");
    // Asked once more, somebody thinks better of it.
    browser.evaluate("document.querySelector('#arm-dialog button[value=cancel]').click()");
    browser.wait_for("!document.querySelector('#arm-dialog').open", PATIENCE);
    browser.press("x");
    executor_state(&mut looker, |state| state == "stopped");
}

#[test]
fn a_bag_is_looked_at_in_the_same_page() {
    let bag = bundled_bag();
    let view = View::start(fresh_domain(), free_port(), &[&bag.to_string_lossy()]);
    let Some(mut browser) = Browser::open(&view.url()) else {
        return;
    };
    browser.wait_for(
        "document.body.dataset.state === 'bag' && wmView.page.shown('camera')",
        PATIENCE,
    );
    browser.wait_for(&format!("{COLOURS}('camera') > 100"), PATIENCE);
    browser.wait_for("wmView.record.frames.length === 50", PATIENCE);
    let missing = text(&mut browser, "#predicted .missing");
    assert!(missing.contains("the bag has no predictions"), "{missing}");
    let stamp = "wmView.page.shown('camera').stamp";
    let first = browser.evaluate(stamp);
    browser.press("ArrowLeft");
    browser.press("ArrowLeft");
    browser.wait_for(&format!("{stamp} !== {first}"), PATIENCE);
    picture(&mut browser, "bag");
    // It plays, at its own pace, and ends where the bag ends.
    browser.evaluate("wmView.page.look(wmView.record.frames.at(-4))");
    browser.press(" ");
    browser.wait_for(
        "!wmView.page.playing && wmView.page.at === wmView.record.newest()",
        PATIENCE,
    );
    let mut socket = view.open();
    socket.send(r#"{"number":1,"command":{"op":"stop"}}"#);
    assert_eq!(socket.answer()["done"], false);
}

#[test]
fn a_client_that_stands_still_costs_nothing_and_slows_nobody() {
    let domain = fresh_domain();
    let view = View::start(domain, free_port(), &[]);
    // 750 KB/s: within seconds more than the kernel holds for a client that does not read.
    let _player = player(domain, "10");
    let mut others: Vec<Socket> = (0..10).map(|_| view.open()).collect();
    others[0].frame();
    let mut stalled = view.open();
    stalled.frame();
    let before = resident(view.process.pid());
    // Ten clients get the frames while the eleventh reads nothing.
    let start = Instant::now();
    let mut seen = vec![BTreeSet::new(); others.len()];
    while start.elapsed() < Duration::from_secs(6) {
        for (socket, seen) in others.iter_mut().zip(&mut seen) {
            seen.insert(socket.frame().0);
        }
    }
    let common = seen
        .iter()
        .skip(1)
        .fold(seen[0].clone(), |all, one| &all & one);
    assert!(common.len() > 50, "{}", common.len());
    let grown = resident(view.process.pid()).saturating_sub(before);
    // What is kept is kept once, for the minute, and not for each client.
    assert!(grown < 24 << 20, "{grown} bytes more");
    // When it reads again, it is soon at the present: what came in between it never gets.
    let newest = *seen[0].last().expect("frames");
    let mut read = 1;
    while stalled.frame().0 < newest {
        read += 1;
    }
    assert!(read < common.len(), "{read} of {}", common.len());
}

/// The header of a frame of this many bytes that never come.
fn frame_of(bytes: u64) -> Vec<u8> {
    let mut header = vec![0x81, 0x80 | 127];
    header.extend(bytes.to_be_bytes());
    header.extend([0; 4]);
    header
}

#[test]
fn hostile_clients_are_refused_and_harm_nobody() {
    let domain = fresh_domain();
    let folder = tempfile::tempdir().expect("a temporary directory");
    let token = folder.path().join("token");
    std::fs::write(&token, "0123456789abcdef\n").expect("the folder is writable");
    let args = [
        "--token-file",
        &token.to_string_lossy(),
        "--max-clients",
        "3",
    ];
    let view = View::start(domain, free_port(), &args);
    let _player = player(domain, "1");
    let port = view.port;
    let own = format!("http://127.0.0.1:{port}");
    let protocols = (
        "Sec-WebSocket-Protocol",
        "wm.view.v1, wm.token.0123456789abcdef",
    );
    let wrong = (
        "Sec-WebSocket-Protocol",
        "wm.view.v1, wm.token.0123456789abcdee",
    );
    let cases: [(u16, &[(&str, &str)]); 7] = [
        (101, &[protocols, ("Origin", &own)]),
        (401, &[("Origin", &own)]),
        (401, &[wrong, ("Origin", &own)]),
        (403, &[protocols, ("Origin", "http://evil.example")]),
        (403, &[protocols, ("Origin", "null")]),
        (
            421,
            &[
                protocols,
                ("Host", "evil.example"),
                ("Origin", "http://evil.example"),
            ],
        ),
        (
            400,
            &[("Sec-WebSocket-Protocol", "other, wm.token.0123456789abcdef")],
        ),
    ];
    for (expected, headers) in cases {
        assert_eq!(open(port, headers).0, expected, "{headers:?}");
    }
    assert_eq!(body(port, "/access", &[]).0, 401);
    let bearer = ("Authorization", "Bearer 0123456789abcdef");
    assert_eq!(body(port, "/access", &[bearer]).0, 204);
    assert_eq!(body(port, "/picture/camera/1/1/0", &[]).0, 401);
    assert_eq!(body(port, "/picture/camera/1/1/0", &[bearer]).0, 404);
    assert_eq!(body(port, "/", &[("Host", "evil.example")]).0, 421);
    let (status, page) = body(port, "/", &[]);
    assert!(status == 200 && page.starts_with(b"<!doctype html>"));

    let client = || open(port, &[protocols]);
    let mut good = client().1.expect("a socket");
    good.frame();
    let before = resident(view.process.pid());
    let long = format!("{{\"number\":1,\"command\":\"{}\"}}", "x".repeat(20_000));
    let hostile: [&[u8]; 4] = [
        &frame_of(1 << 30),
        &frame_of(u64::MAX),
        &[0xff; 64],
        &[&frame_of(20_000)[..], long.as_bytes()].concat(),
    ];
    for bytes in hostile {
        let mut socket = client().1.expect("a socket");
        // The server may have closed it before all is sent.
        let _ = socket.send_raw(bytes);
        while !matches!(socket.receive(), Message::Closed) {}
    }
    for text in ["{}", "[1]", r#"{"number":1,"command":{"op":"launch"}}"#] {
        let mut socket = client().1.expect("a socket");
        socket.send(text);
        while !matches!(socket.receive(), Message::Closed) {}
    }
    let grown = resident(view.process.pid()).saturating_sub(before);
    assert!(grown < 16 << 20, "{grown} bytes more");
    let (first, _) = good.frame();
    assert!(good.frame().0 > first, "the good client is served on");

    // One more than there may be, once those that were refused are gone.
    let mut held = Vec::new();
    let start = Instant::now();
    while held.len() < 2 && start.elapsed() < PATIENCE {
        held.extend(client().1);
    }
    assert_eq!((held.len(), client().0), (2, 503));
    drop(held);
    wait_until("places are free again", PATIENCE, || client().0 == 101);
}

#[test]
fn a_port_that_is_taken_and_a_bag_that_is_none_are_named() {
    let listener = TcpListener::bind(("127.0.0.1", 0)).expect("a port");
    let port = listener
        .local_addr()
        .expect("an address")
        .port()
        .to_string();
    let failed = |args: &[&str]| {
        let output = wm(fresh_domain(), args).output().expect("wm runs");
        assert_eq!(output.status.code(), Some(1), "{args:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let error = failed(&["view", "--port", &port]);
    assert!(
        error.contains(&port) && error.contains("port:=0"),
        "{error}"
    );
    let error = failed(&["view", "/no/such/bag"]);
    assert!(error.contains("no bag at /no/such/bag"), "{error}");
    let error = failed(&["view", "--address", "robot"]);
    assert!(error.contains("\"robot\""), "{error}");
}

#[test]
fn beyond_loopback_the_page_needs_the_token_that_is_printed() {
    let port = free_port();
    let port_text = port.to_string();
    let args = ["view", "--port", &port_text, "--address", "0.0.0.0"];
    let process = Process::start(wm(fresh_domain(), &args));
    wait_until("the page is served", PATIENCE, || {
        std::net::TcpStream::connect(("127.0.0.1", port)).is_ok()
    });
    assert_eq!(body(port, "/access", &[]).0, 401);
    let url = format!("http://127.0.0.1:{port}/");
    let found = Browser::open(&url).map(|mut browser| {
        browser.wait_for("document.body.dataset.state === 'refused' && !document.querySelector('#token-form').hidden", PATIENCE);
        browser
    });
    process.signal(Signal::INT);
    let (_, stdout) = process.finish(PATIENCE);
    let token = stdout.split("#token=").nth(1).map(str::trim);
    let token = token
        .unwrap_or_else(|| panic!("no token: {stdout}"))
        .to_owned();
    assert_eq!(token.len(), 32);
    drop(found);

    // With it, in the address, the page opens; and the address no longer shows it.
    let folder = tempfile::tempdir().expect("a temporary directory");
    let file = folder.path().join("token");
    std::fs::write(&file, &token).expect("the folder is writable");
    let view = View::start(
        fresh_domain(),
        port,
        &[
            "--address",
            "0.0.0.0",
            "--token-file",
            &file.to_string_lossy(),
        ],
    );
    let Some(mut browser) = Browser::open(&format!("{}#token={token}", view.url())) else {
        return;
    };
    browser.wait_for("document.body.dataset.state === 'live'", PATIENCE);
    assert_eq!(browser.evaluate("location.hash"), Value::from(""));
}
