//! A real headless browser, driven over the DevTools protocol.

use crate::harness::Process;
use serde_json::{Value, json};
use std::{
    fs::File,
    io::{BufRead as _, BufReader, Write as _},
    path::Path,
    process::Command,
    sync::mpsc::{Receiver, channel},
    time::{Duration, Instant},
};
use tempfile::TempDir;

/// How long the browser may take to reply: it shares two processors with the nodes.
const ANSWER_LIMIT: Duration = Duration::from_secs(60);

/// A browser with one page.
pub struct Browser {
    commands: File,
    messages: Receiver<Value>,
    number: u64,
    session: String,
    _process: Process,
    _folder: TempDir,
}

/// The name of an installed browser; `None`, with a message, if there is none.
fn installed() -> Option<&'static str> {
    let browsers = ["chromium-headless-shell", "chromium", "google-chrome"];
    let is_there = |name: &&str| Command::new(name).arg("--version").output().is_ok();
    let found = browsers.into_iter().find(is_there);
    if found.is_none() {
        eprintln!("skipped: none of {browsers:?} is installed; tests/setup_system installs one");
        assert!(
            std::env::var_os("CI").is_none(),
            "the page may not go untested in CI"
        );
    }
    found
}

impl Browser {
    /// Opens `url` in a new browser; `None` if none is installed.
    pub fn open(url: &str) -> Option<Self> {
        let name = installed()?;
        let folder = tempfile::tempdir().expect("a temporary directory");
        let path = |name: &str| folder.path().join(name);
        let (input, output) = (path("input"), path("output"));
        let made = Command::new("mkfifo").args([&input, &output]).status();
        assert!(made.expect("mkfifo runs").success());
        // The browser receives commands on descriptor 3 and replies on 4; the shell opens them one after the other.
        let mut command = Command::new("sh");
        command
            .args([
                "-c",
                "exec \"$0\" \"$@\" 3<\"$INPUT\" 4>\"$OUTPUT\" 2>/dev/null",
                name,
            ])
            .args([
                "--headless",
                "--no-sandbox",
                "--disable-gpu",
                "--disable-quic",
                "--no-first-run",
            ])
            .args([
                "--disable-background-networking",
                "--disable-component-update",
                "--disable-sync",
            ])
            .args(["--hide-scrollbars", "--remote-debugging-pipe"])
            .arg(format!("--user-data-dir={}", path("profile").display()))
            .env("INPUT", &input)
            .env("OUTPUT", &output);
        let process = Process::start(command);
        let commands = File::create(&input).expect("the pipe to the browser");
        let answers = File::open(&output).expect("the pipe from the browser");
        let (sender, messages) = channel();
        std::thread::spawn(move || {
            for message in BufReader::new(answers).split(0) {
                let Ok(message) = message else { break };
                let Ok(message) = serde_json::from_slice(&message) else {
                    break;
                };
                if sender.send(message).is_err() {
                    break;
                }
            }
        });
        let mut browser = Self {
            commands,
            messages,
            number: 0,
            session: String::new(),
            _process: process,
            _folder: folder,
        };
        let target = browser.call("Target.createTarget", json!({ "url": "about:blank" }));
        let attach = json!({ "targetId": target["targetId"], "flatten": true });
        let attached = browser.call("Target.attachToTarget", attach);
        browser.session = attached["sessionId"]
            .as_str()
            .expect("a session")
            .to_owned();
        browser.size(1400, 1000);
        browser.call("Page.navigate", json!({ "url": url }));
        Some(browser)
    }

    /// Executes a command of the DevTools protocol.
    fn call(&mut self, method: &str, parameters: Value) -> Value {
        self.number += 1;
        let mut message = json!({ "id": self.number, "method": method, "params": parameters });
        if !self.session.is_empty() {
            message["sessionId"] = json!(self.session);
        }
        let mut bytes = message.to_string().into_bytes();
        bytes.push(0);
        self.commands
            .write_all(&bytes)
            .expect("the browser listens");
        let start = Instant::now();
        loop {
            let left = ANSWER_LIMIT.saturating_sub(start.elapsed());
            let mut message = self
                .messages
                .recv_timeout(left)
                .expect("the browser answers");
            if message["id"] == json!(self.number) {
                assert!(message["error"].is_null(), "{method}: {message}");
                return message["result"].take();
            }
        }
    }

    /// The value of a JavaScript expression in the page; awaits promises.
    pub fn evaluate(&mut self, expression: &str) -> Value {
        let parameters =
            json!({ "expression": expression, "awaitPromise": true, "returnByValue": true });
        let mut result = self.call("Runtime.evaluate", parameters);
        assert!(
            result["exceptionDetails"].is_null(),
            "{expression}: {result}"
        );
        result["result"]["value"].take()
    }

    /// Waits until an expression is true.
    pub fn wait_for(&mut self, expression: &str, limit: Duration) {
        let start = Instant::now();
        let guarded = format!(
            "(() => {{ try {{ return Boolean({expression}); }} catch {{ return false; }} }})()"
        );
        while self.evaluate(&guarded) != json!(true) {
            if start.elapsed() > limit {
                let text = self.evaluate("document.body.innerText");
                panic!("not within {limit:?}: {expression}; the page says: {text}");
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Presses a key.
    pub fn press(&mut self, key: &str) {
        for kind in ["keyDown", "keyUp"] {
            self.call(
                "Input.dispatchKeyEvent",
                json!({ "type": kind, "key": key }),
            );
        }
    }

    /// Sets the size of the window \[px\]; below 760, that of a phone.
    pub fn size(&mut self, width: u32, height: u32) {
        let parameters = json!({ "width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 760 });
        self.call("Emulation.setDeviceMetricsOverride", parameters);
    }

    /// Sets the preference for light or dark pages.
    pub fn prefer(&mut self, scheme: &str) {
        let features = json!([{ "name": "prefers-color-scheme", "value": scheme }]);
        self.call(
            "Emulation.setEmulatedMedia",
            json!({ "features": features }),
        );
    }

    /// Writes a screenshot as PNG.
    pub fn screenshot(&mut self, path: &Path) {
        let png = self.call("Page.captureScreenshot", json!({ "format": "png" }));
        let data = png["data"].as_str().expect("base64");
        let decoded = self.decode(data);
        std::fs::write(path, decoded).expect("the folder is writable");
    }

    /// Decodes Base64 in the browser, so that the tests need no library.
    fn decode(&mut self, data: &str) -> Vec<u8> {
        let expression = format!("Array.from(atob({}), (c) => c.charCodeAt(0))", json!(data));
        let bytes = self.evaluate(&expression);
        serde_json::from_value(bytes).expect("bytes")
    }
}
