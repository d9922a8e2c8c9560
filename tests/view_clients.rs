//! Slow, many, hostile and remote clients of `wm view`.

use std::time::Instant;

use serde_json::{Value, json};

use crate::{
    browser::Browser,
    harness::{Process, Signal, fresh_domain, resident, wait_until, wm},
    view_process::{PATIENCE, View, body, page_port, player},
    websocket::{Socket, catch_up, frame_of, open, read_beside},
};

#[test]
fn stalled_client_costs_nothing_and_slows_no_other() {
    let domain = fresh_domain();
    let view = View::start(domain, &[]);
    // 750 KB/s: within seconds more than the kernel buffers for a client that does not read
    let _player = player(domain, "10");
    let mut others: Vec<Socket> = (0..10).map(|_| view.open()).collect();
    others[0].frame();
    let mut stalled = view.open();
    stalled.frame();
    let before = resident(view.process.pid());
    // ten clients get the frames while the eleventh reads nothing
    let stamp = |socket: &mut Socket| socket.frame().0;
    let common = read_beside(&mut others, stamp, || {});
    let grown = resident(view.process.pid()).saturating_sub(before);
    // pictures are kept once for a minute, not once per client
    assert!(grown < 24 << 20, "{grown} bytes more");
    catch_up(&mut stalled, stamp, &common);
}

#[test]
fn hostile_clients_are_refused_and_do_no_harm() {
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
    let view = View::start(domain, &args);
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
        // the server may have closed it before everything is sent
        let _ = socket.send_raw(bytes);
        socket.until_closed();
    }
    // an invalid command is answered with its fault, and the client stays connected
    let mut clumsy = client().1.expect("a socket");
    let cases = [
        ("{}", None, "\"number\" is missing"),
        (
            r#"{"number":1,"command":{"op":"launch"}}"#,
            Some(1),
            "\"launch\"",
        ),
        (
            r#"{"number":2,"command":{"op":"arm"}}"#,
            Some(2),
            "op \"arm\": the field \"armed\" is missing",
        ),
    ];
    for (text, number, reason) in cases {
        clumsy.send(text);
        let answer = clumsy.answer();
        assert_eq!(
            (answer["number"].as_u64(), &answer["done"]),
            (number, &json!(false)),
            "{answer}"
        );
        assert!(
            answer["text"]
                .as_str()
                .is_some_and(|text| text.contains(reason)),
            "{answer}"
        );
    }
    clumsy.frame();
    // after the 20 invalid messages in docs/view.md, of which three were sent, the client is disconnected
    for _ in 0..17 {
        clumsy.send("[1]");
        clumsy.answer();
    }
    clumsy.send("[1]");
    clumsy.until_closed();
    let grown = resident(view.process.pid()).saturating_sub(before);
    assert!(grown < 16 << 20, "{grown} bytes more");
    let (first, _) = good.frame();
    assert!(good.frame().0 > first, "the good client is served on");

    // one client too many, once the refused ones have gone
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
fn page_beyond_loopback_needs_the_printed_token() {
    let args = ["view", "--port", "0", "--address", "0.0.0.0"];
    let process = Process::start(wm(fresh_domain(), &args));
    let port = page_port(&process);
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

    // the page opens with the token in its address, and then hides it
    let folder = tempfile::tempdir().expect("a temporary directory");
    let file = folder.path().join("token");
    std::fs::write(&file, &token).expect("the folder is writable");
    let view = View::start(
        fresh_domain(),
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
    // connected, but not live before the first frame
    browser.wait_for("document.body.dataset.state === 'waiting'", PATIENCE);
    assert_eq!(browser.evaluate("location.hash"), Value::from(""));
}
