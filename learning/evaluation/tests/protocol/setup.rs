//! A judge with the test server, without waits.

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex},
    time::Duration,
};

use image::{Rgb, RgbImage};
use serde_json::Value;
use wm_evaluation::judges::{
    EndpointSettings, FrameChoice, Judge, Prompts, Record, Rollout, SuccessScore, endpoint::Clock,
};

use super::server::{Request, Response, Server};

/// Sleeping advances it, and is recorded.
#[derive(Debug, Default)]
pub struct FakeClock(Mutex<Vec<Duration>>);

impl Clock for FakeClock {
    fn now(&self) -> Duration {
        self.0.lock().unwrap().iter().sum()
    }

    fn unix_s(&self) -> u64 {
        784_111_770
    }

    fn sleep(&self, duration: Duration) {
        self.0.lock().unwrap().push(duration);
    }
}

impl FakeClock {
    pub fn slept_s(&self) -> Vec<f64> {
        let slept = self.0.lock().unwrap();
        slept.iter().map(Duration::as_secs_f64).collect()
    }
}

/// A server with a judge and a record.
pub struct Setup {
    pub server: Server,
    pub clock: Arc<FakeClock>,
    dir: tempfile::TempDir,
    pub settings: EndpointSettings,
}

impl Setup {
    pub fn new(script: impl Fn(usize, &Request) -> Response + Send + 'static) -> Self {
        let server = Server::new(script);
        let settings = EndpointSettings::new("no_judge", &server.base_url(), "test-server");
        Self {
            server,
            clock: Arc::default(),
            dir: tempfile::tempdir().unwrap(),
            settings,
        }
    }

    pub fn judge(&self) -> Judge {
        let prompts = Arc::new(Prompts::paper().unwrap());
        let clock: Arc<dyn Clock> = self.clock.clone();
        let settings = self.settings.clone();
        Judge::with_clock(settings, prompts, FrameChoice::default(), clock).unwrap()
    }

    pub fn path(&self) -> PathBuf {
        self.dir.path().join("answers.jsonl")
    }

    pub fn record(&self) -> Record {
        Record::open(&self.path()).unwrap()
    }

    /// Judges the rollout in a new session.
    pub fn ask(&self, trial: u64) -> wm_evaluation::judges::Result<Option<SuccessScore>> {
        let judged = self.judge().success(&rollout(trial), &mut self.record());
        Ok(judged?.verdict)
    }

    pub fn requests(&self) -> usize {
        self.server.requests().len()
    }
}

pub fn rollout(trial: u64) -> Rollout {
    let frame = |t| RgbImage::from_fn(8, 6, |x, y| Rgb([t as u8, (x * y) as u8, trial as u8]));
    let mut rollout = Rollout::new("close oven", (0..20).map(frame).collect());
    rollout.trial = trial;
    rollout.stamp_ns = 1_700_000_000_000_000_000;
    rollout
}

pub fn entries(path: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().skip(1);
    lines
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}
