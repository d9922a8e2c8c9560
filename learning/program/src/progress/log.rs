//! Lines where there is no terminal.

use crate::progress::SharedPace;
use indicatif::{BinaryBytes, HumanDuration, ProgressBar};
use std::io::Write;
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::JoinHandle;
use std::time::Duration;

/// A thread that writes a line now and then, until this is dropped.
pub(crate) struct Log {
    stop: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Log {
    /// None where there is no thread to be had: then there is no progress to see, and that is all.
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
                // That nobody can be told is no reason to stop the work.
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
        total => text.push_str(&pace.in_words(total)),
    }
    text
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use indicatif::ProgressDrawTarget;

    /// What was written, piece by piece.
    struct Told(Sender<String>);

    impl Write for Told {
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

    /// Pieces until one has all of it.
    fn until(told: &mpsc::Receiver<String>, wanted: &str) {
        let mut all = String::new();
        while !all.contains(wanted) {
            all.push_str(&told.recv_timeout(Duration::from_secs(20)).unwrap());
        }
    }

    #[test]
    fn a_log_gets_whole_lines_and_goes_on_without_a_step() {
        let (sender, told) = mpsc::channel();
        let bar = hidden(Some(4));
        let output = Box::new(Told(sender));
        let log = Log::start(
            bar.clone(),
            SharedPace::default(),
            "bags",
            Duration::from_millis(1),
            output,
        )
        .unwrap();
        until(&told, "reading: 0 of 4 bags\n");
        bar.inc(3);
        bar.set_message("loss 0.5");
        until(&told, "reading: 3 of 4 bags, loss 0.5");
        drop(log);
        // Nobody tells any more: the channel ends.
        while told.recv_timeout(Duration::from_secs(20)).is_ok() {}
    }

    #[test]
    fn what_has_no_end_tells_how_long_it_has_taken() {
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
