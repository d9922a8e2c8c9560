//! The page of `wm view`, in a real browser.

use std::{
    net::TcpListener,
    path::PathBuf,
    time::{Duration, Instant},
};

use serde_json::json;
use wm_msgs::{
    builtin_interfaces::{self, Time},
    std_msgs::Header,
    wm_msgs::{Action, ActionCandidates, ActionChunk},
};
use wm_ros::Qos;

use crate::{
    browser::Browser,
    harness::{Process, Signal, bundled_bag, fresh_domain, join, whole_suite, wm},
    view_process::{PATIENCE, View, page_port, player},
    websocket::Socket,
};

/// The folder for screenshots; `None` unless requested.
fn gallery() -> Option<PathBuf> {
    std::env::var_os("WM_VIEW_SCREENSHOTS").map(PathBuf::from)
}

fn picture(browser: &mut Browser, name: &str) {
    if let Some(folder) = gallery() {
        browser.screenshot(&folder.join(format!("{name}.png")));
    }
}

/// The number of colours on a panel's canvas, and whether the picture changed since the last call.
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
fn page_shows_the_main_job_live() {
    let _alone = whole_suite();
    let domain = fresh_domain();
    let out = tempfile::tempdir().expect("a temporary directory");
    let output = format!("output:={}", out.path().display());
    let file = "launch-configs/replay.launch.yaml";
    let args = [
        "launch",
        file,
        &output,
        "loop:=true",
        "rate:=0.5",
        "view:=true",
        "view_port:=0",
    ];
    let launch = Process::start(wm(domain, &args));
    let url = format!("http://127.0.0.1:{}/", page_port(&launch));
    let Some(mut browser) = Browser::open(&url) else {
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
    // on failure the wait reports this: the drawing a quarter of a second later
    browser.wait_for(
        "document.querySelector('#plan-cost').innerText.startsWith('cost ')",
        PATIENCE,
    );
    browser.wait_for(
        "document.querySelector('#goal canvas').width > 100",
        PATIENCE,
    );
    // the arrows of a plan begin at the gripper, in the upper half of the picture
    browser.wait_for(
        "wmView.page.way?.points[0].every((at) => at > 0 && at < 1) && wmView.page.way.points[0][1] < 0.6",
        PATIENCE,
    );
    picture(&mut browser, "live");
    let horizon = browser.evaluate("document.querySelectorAll('#strip button').length");
    assert_eq!(horizon, 8);

    // another k shows another picture
    browser.press("4");
    browser.wait_for("wmView.page.shown('predicted')?.k === 4", PATIENCE);
    assert!(text(&mut browser, "#k-text").starts_with("k=4, 1.6 s"));

    // nothing moves while paused; a step back shows the previous frame
    browser.press(" ");
    browser.wait_for("document.body.dataset.state === 'paused'", PATIENCE);
    let at = "wmView.page.shown('camera').stamp";
    let first = browser.evaluate(at);
    // not the number of frames, which stays once the oldest are pruned
    browser.wait_for(
        &format!("BigInt(wmView.record.newest().stamp) > BigInt({first}) + 1500000000n"),
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
    // frames are 0.2 s apart, at half the rate; a busy machine may miss one
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

    // on a phone, in full height, with the dark theme
    browser.size(390, 2700);
    for scheme in ["light", "dark"] {
        browser.prefer(scheme);
        browser.wait_for("document.documentElement.scrollWidth <= 390", PATIENCE);
        picture(&mut browser, &format!("phone-{scheme}"));
    }
    // there, prediction and difference share a place
    let is_seen = |id: &str| format!("document.querySelector('#{id}').offsetParent !== null");
    for [shown, hidden] in [["predicted", "difference"], ["difference", "predicted"]] {
        browser.wait_for(&is_seen(shown), PATIENCE);
        assert_eq!(browser.evaluate(&is_seen(hidden)), false, "{hidden}");
        browser.evaluate(&format!("document.querySelector('#{shown} .swap').click()"));
    }
    browser.size(1400, 1000);
    picture(&mut browser, "dark");

    // without control, the page offers none and the node accepts none
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
fn page_names_missing_data_and_reconnects_to_its_node() {
    let domain = fresh_domain();
    let view = View::start(domain, &[]);
    let port = view.port;
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
    assert_eq!(
        text(&mut browser, "#state"),
        "connected, waiting for /camera/image_raw"
    );
    picture(&mut browser, "empty");

    let camera = player(domain, "1");
    browser.wait_for("wmView.page.latencies.length > 3", PATIENCE);
    assert!(colours(&mut browser, "camera") > 100);
    assert_eq!(text(&mut browser, "#state"), "live");
    // a stopped camera is not live, and the page shows since when
    drop(camera);
    browser.wait_for("document.body.dataset.state === 'stale'", PATIENCE);
    let state = text(&mut browser, "#state");
    assert!(state.starts_with("no frame for "), "{state}");
    picture(&mut browser, "stale");
    let _player = player(domain, "1");
    browser.wait_for("document.body.dataset.state === 'live'", PATIENCE);

    // an invalid command is answered and logged; the connection stays
    let answer = browser.evaluate("wmView.connection.ask({ op: 'arm' })");
    let reason = "op \"arm\": the field \"armed\" is missing; expected true or false";
    assert_eq!(
        (&answer["done"], &answer["text"]),
        (&json!(false), &json!(reason))
    );
    browser.wait_for(
        "document.querySelector('#log ol').innerText.includes('\"armed\" is missing')",
        PATIENCE,
    );
    assert_eq!(text(&mut browser, "#state"), "live");

    view.process.signal(Signal::INT);
    let (status, _) = view.process.finish(PATIENCE);
    assert!(status.success(), "{status}");
    browser.wait_for("document.body.dataset.state === 'connecting'", PATIENCE);
    let _again = View::start_at(domain, port, &[]);
    browser.evaluate("wmView.page.latencies.length = 0");
    browser.wait_for(
        "document.body.dataset.state === 'live' && wmView.page.latencies.length > 3",
        PATIENCE,
    );
}

#[test]
fn permitted_page_sets_a_shown_frame_as_goal() {
    let domain = fresh_domain();
    let view = View::start(domain, &["--control", "goals"]);
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
    // The view receives the goal like every node; a paused page shows the goal of its time.
    browser.press("l");
    browser.wait_for("wmView.page.shown('goal')", PATIENCE);
    let goal = browser.evaluate(
        "(async () => { const get = async (label) => {
            const path = [label.source, label.stamp, label.observed, label.k].join('/');
            return Array.from(new Uint8Array(await (await fetch(`/picture/${path}`)).arrayBuffer())).join(); };
         return (await get(wmView.page.shown('goal'))) === (await get(globalThis.seen)); })()",
    );
    assert_eq!(goal, true);
    // no node exists that could be reset, and arming is not permitted
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
        answer["done"] == false && text.contains("/wm/predictor/reset does not exist"),
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

#[test]
fn permitted_page_chooses_a_candidate() {
    let domain = fresh_domain();
    let view = View::start(domain, &["--control", "goals"]);
    let Some(mut browser) = Browser::open(&view.url()) else {
        return;
    };
    let (_context, policy) = join(domain, "policy");
    let offers = policy.publisher::<ActionCandidates>("action_candidates", Qos::reliable(4));
    let offers = offers.expect("a publisher");
    let chunks = policy.subscription::<ActionChunk>("action_chunk", Qos::reliable(4));
    let mut chunks = chunks.expect("a subscription");
    // the page forgets data older than a minute
    let stamp = Time::from_nanos(policy.clock().now().to_nanos());
    let chunk = |dy: f32| {
        let header = Header {
            stamp,
            frame_id: "base_link".to_owned(),
        };
        ActionChunk {
            header: header.clone(),
            period: builtin_interfaces::Duration::from_nanos(200_000_000),
            actions: vec![Action {
                header,
                values: vec![0.0, dy, 0.0, 0.0, 0.0, 0.0, 1.0],
            }],
            ..ActionChunk::default()
        }
    };
    let offer = ActionCandidates {
        header: chunk(0.0).header,
        policy: "two ways".to_owned(),
        chunks: vec![chunk(0.01), chunk(-0.02)],
    };
    let runtime = tokio::runtime::Runtime::new().expect("a runtime");
    runtime.block_on(chunks.wait_for_publishers(1));
    let buttons = "document.querySelectorAll('#candidate-list button')";
    // like a policy that still has no reply: the first message may precede the discovery of its publisher
    let begin = Instant::now();
    while browser.evaluate(&format!("{buttons}.length")) != 2 {
        assert!(begin.elapsed() < PATIENCE, "the candidates are not shown");
        offers.publish(&offer).expect("published");
        std::thread::sleep(Duration::from_millis(100));
    }
    assert_eq!(
        text(&mut browser, "#candidates-text"),
        "2 offered by two ways"
    );
    picture(&mut browser, "candidates");
    browser.evaluate(&format!("{buttons}[1].click()"));
    browser.wait_for(
        "document.querySelector('#toast').innerText === 'candidate 1 is published on /wm/action_chunk'",
        PATIENCE,
    );
    let picked = runtime.block_on(async { tokio::time::timeout(PATIENCE, chunks.recv()).await });
    let picked = picked.expect("it comes in time").expect("no shutdown");
    assert_eq!(picked.message, offer.chunks[1]);
}

/// The executor's state and reason, from the next status whose state satisfies `is_so`.
fn executor_state(socket: &mut Socket, is_so: impl Fn(&str) -> bool) -> (String, String) {
    socket.until_op("status", |status| {
        let text = |key: &str| status["executor"][key].as_str().map(str::to_owned);
        let state = text("state").filter(|state| is_so(state))?;
        Some((state, text("reason")?))
    })
}

#[test]
fn every_page_stops_the_executor_but_only_permitted_ones_arm() {
    let domain = fresh_domain();
    let _executor = Process::start(wm(domain, &["executor"]));
    let looking = View::start(domain, &[]);
    let arming = View::start(domain, &["--control", "all"]);
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
        assert_eq!(executor_state(socket, |_| true).0, "dry run");
    }
    for command in [arm, release] {
        let (is_done, text) = ask(&mut looker, command);
        assert!(!is_done && text.contains("not permitted"), "{text}");
    }
    assert!(ask(&mut armer, arm).0);
    executor_state(&mut looker, |state| state == "idle");
    let (is_done, text) = ask(&mut looker, stop);
    assert!(is_done, "{text}");
    // readers may not know the meaning of `~`, but want to know the origin
    let (_, reason) = executor_state(&mut looker, |state| state == "stopped");
    assert_eq!(
        reason,
        "/wm/view called /wm/executor/stop; to go on, call /wm/executor/reset, then /wm/executor/arm"
    );
    // it stays stopped until someone with permission releases it
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
    // the user cancels in the dialog
    browser.evaluate("document.querySelector('#arm-dialog button[value=cancel]').click()");
    browser.wait_for("!document.querySelector('#arm-dialog').open", PATIENCE);
    browser.press("x");
    executor_state(&mut looker, |state| state == "stopped");
}

#[test]
fn bag_is_shown_in_the_same_page() {
    let bag = bundled_bag();
    let view = View::start(fresh_domain(), &[&bag.to_string_lossy()]);
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
    // it plays at its own pace, and ends with the bag
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
fn errors_name_a_taken_port_and_an_invalid_bag() {
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
        error.contains(&port) && error.contains("--port PORT"),
        "{error}"
    );
    let error = failed(&["view", "/no/such/bag"]);
    assert!(
        error.contains("no bag at /no/such/bag") && error.matches("/no/such/bag").count() == 1,
        "{error}"
    );
    let error = failed(&["view", "--address", "robot"]);
    assert!(error.contains("\"robot\""), "{error}");
}
