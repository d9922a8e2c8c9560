//! Progress lines without a terminal.

use super::pace::SharedPace;
use indicatif::{BinaryBytes, HumanDuration, ProgressBar};
use std::io::Write;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::Duration;

/// A thread that writes a line per period until this is dropped.
pub(crate) struct Log {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Log {
    /// Starts the thread; without one there is no progress output, and `None` is returned.
    pub fn start(
        bar: ProgressBar,
        pace: SharedPace,
        things: &'static str,
        period: Duration,
        mut output: Box<dyn Write + Send>,
    ) -> Option<Self> {
        let (stop, stopped) = mpsc::channel();
        let write = move || {
            while stopped.recv_timeout(period) == Err(RecvTimeoutError::Timeout) {
                // Without a reader, the work continues.
                writeln!(output, "{}", line(&bar, &pace, things))
                    .and_then(|()| output.flush())
                    .ok();
            }
        };
        let thread = std::thread::Builder::new().name("progress".to_owned());
        Some(Self {
            stop: Some(stop),
            thread: Some(thread.spawn(write).ok()?),
        })
    }
}

impl Drop for Log {
    fn drop(&mut self) {
        self.stop.take();
        if let Some(thread) = self.thread.take() {
            thread.join().ok();
        }
    }
}

/// `reading: 3 of 12 bags, loss 0.5, 40s left`.
fn line(bar: &ProgressBar, pace: &SharedPace, things: &str) -> String {
    let count = |number: u64| match things {
        "bytes" => BinaryBytes(number).to_string(),
        _ => number.to_string(),
    };
    let things = match things {
        "bytes" => String::new(),
        _ => format!(" {things}"),
    };
    let mut text = bar.prefix();
    match (bar.length(), bar.position()) {
        (Some(total), done) => {
            text.push_str(&format!(": {} of {}{things}", count(done), count(total)));
        }
        (None, 0) => {}
        (None, done) => text.push_str(&format!(": {}{things}", count(done))),
    }
    if !bar.message().is_empty() {
        text.push_str(&format!(", {}", bar.message()));
    }
    match bar.length() {
        None => text.push_str(&format!(", {:#} so far", HumanDuration(bar.elapsed()))),
        total => text.push_str(&pace.describe_rest(total)),
    }
    text
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use indicatif::ProgressDrawTarget;

    struct LineSender(Sender<String>);

    impl Write for LineSender {
        fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
            self.0
                .send(String::from_utf8_lossy(bytes).into_owned())
                .ok();
            Ok(bytes.len())
        }

        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }

    fn hidden(total: Option<u64>) -> ProgressBar {
        ProgressBar::with_draw_target(total, ProgressDrawTarget::hidden()).with_prefix("reading")
    }

    /// Receives pieces until they contain `wanted`.
    fn wait_for(lines: &mpsc::Receiver<String>, wanted: &str) {
        let mut all = String::new();
        while !all.contains(wanted) {
            all.push_str(&lines.recv_timeout(Duration::from_secs(20)).unwrap());
        }
    }

    #[test]
    fn log_writes_whole_lines_without_further_steps() {
        let (sender, lines) = mpsc::channel();
        let bar = hidden(Some(4));
        let output = Box::new(LineSender(sender));
        let log = Log::start(
            bar.clone(),
            SharedPace::default(),
            "bags",
            Duration::from_millis(1),
            output,
        )
        .unwrap();
        wait_for(&lines, "reading: 0 of 4 bags\n");
        bar.inc(3);
        bar.set_message("loss 0.5");
        wait_for(&lines, "reading: 3 of 4 bags, loss 0.5");
        drop(log);
        // The thread has ended: the channel closes.
        while lines.recv_timeout(Duration::from_secs(20)).is_ok() {}
    }

    #[test]
    fn open_ended_progress_shows_the_elapsed_time() {
        let bar = hidden(None).with_elapsed(Duration::from_secs(70));
        assert_eq!(
            line(&bar, &SharedPace::default(), "bytes"),
            "reading, 70s so far"
        );
        bar.inc(3 << 20);
        assert_eq!(
            line(&bar, &SharedPace::default(), "bytes"),
            "reading: 3.00 MiB, 70s so far"
        );
    }
}
