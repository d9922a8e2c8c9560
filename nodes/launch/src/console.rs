//! The launch's screen: lines of all processes, each with its process's name, and one live line at the bottom.
//!
//! A process prints its live line with a leading carriage return. On a terminal the newest one stays below all other
//! lines. Elsewhere it is printed from time to time as an ordinary line.

use std::io::{self, Write};
use std::time::{Duration, Instant};

/// How often the live line is printed without a terminal.
const LIVE_PERIOD: Duration = Duration::from_secs(5);

/// Moves to the first column and clears the line.
const CLEAR_LINE: &str = "\r\x1b[2K";

/// The stream of a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Stream {
    /// Standard output.
    Out,
    /// Standard error.
    Err,
}

/// `O` and `E` are the launcher's standard output and error, or memory in tests.
pub(crate) struct Console<O, E> {
    out: O,
    err: E,
    /// The width of the terminal of `err`; `None` if it is not a terminal.
    columns: Option<usize>,
    live: Option<String>,
    live_printed: Option<Instant>,
}

impl<O: Write, E: Write> Console<O, E> {
    /// `columns`: the width of the terminal of standard error, if it is one.
    pub(crate) fn new(out: O, err: E, columns: Option<usize>) -> Self {
        Self {
            out,
            err,
            columns,
            live: None,
            live_printed: None,
        }
    }

    /// Prints one line of process `name`.
    ///
    /// # Errors
    /// The stream cannot be written, for example because its reader is gone.
    pub(crate) fn line(
        &mut self,
        name: &str,
        stream: Stream,
        text: &str,
        now: Instant,
    ) -> io::Result<()> {
        if let Some(live) = text.strip_prefix('\r') {
            return self.live(name, live, now);
        }
        self.hide_live()?;
        match stream {
            Stream::Out => {
                writeln!(self.out, "[{name}] {text}")?;
                self.out.flush()?;
            }
            Stream::Err => {
                writeln!(self.err, "[{name}] {text}")?;
                self.err.flush()?;
            }
        }
        self.show_live()
    }

    /// Prints a line of the launcher itself.
    ///
    /// # Errors
    /// See [`Self::line`].
    pub(crate) fn print_own(&mut self, text: &str) -> io::Result<()> {
        self.hide_live()?;
        writeln!(self.err, "[launch] {text}")?;
        self.err.flush()?;
        self.show_live()
    }

    /// Removes the live line.
    ///
    /// # Errors
    /// See [`Self::line`].
    pub(crate) fn finish(&mut self) -> io::Result<()> {
        self.hide_live()?;
        self.live = None;
        self.err.flush()
    }

    fn live(&mut self, name: &str, text: &str, now: Instant) -> io::Result<()> {
        if self.columns.is_some() {
            self.live = Some(text.trim_end().to_owned());
            write!(self.err, "{CLEAR_LINE}")?;
            return self.show_live();
        }
        let is_due = self
            .live_printed
            .is_none_or(|printed| now.duration_since(printed) >= LIVE_PERIOD);
        if is_due {
            self.live_printed = Some(now);
            writeln!(self.err, "[{name}] {}", text.trim_end())?;
            self.err.flush()?;
        }
        Ok(())
    }

    fn hide_live(&mut self) -> io::Result<()> {
        if self.live.is_some() {
            write!(self.err, "{CLEAR_LINE}").and_then(|()| self.err.flush())
        } else {
            Ok(())
        }
    }

    fn show_live(&mut self) -> io::Result<()> {
        let (Some(live), Some(columns)) = (&self.live, self.columns) else {
            return Ok(());
        };
        // a wrapped line could not be cleared
        let shown: String = live.chars().take(columns.saturating_sub(1)).collect();
        write!(self.err, "{shown}")?;
        self.err.flush()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_carry_their_process_and_stream() {
        let mut console = Console::new(Vec::new(), Vec::new(), None);
        let now = Instant::now();
        console
            .line("encoder-1", Stream::Err, "[INFO] ready", now)
            .unwrap();
        console
            .line("monitor-2", Stream::Out, "table", now)
            .unwrap();
        console.print_own("stopping").unwrap();
        assert_eq!(
            String::from_utf8(console.out).unwrap(),
            "[monitor-2] table\n"
        );
        assert_eq!(
            String::from_utf8(console.err).unwrap(),
            "[encoder-1] [INFO] ready\n[launch] stopping\n"
        );
    }

    #[test]
    fn live_line_stays_at_the_bottom_of_a_terminal() {
        let mut console = Console::new(Vec::new(), Vec::new(), Some(9));
        let now = Instant::now();
        console
            .line("monitor-1", Stream::Out, "\r5.0 Hz, k=1", now)
            .unwrap();
        console.line("encoder-2", Stream::Err, "warn", now).unwrap();
        console.finish().unwrap();
        let expected = "\r\x1b[2K5.0 Hz, \r\x1b[2K[encoder-2] warn\n5.0 Hz, \r\x1b[2K";
        assert_eq!(String::from_utf8(console.err).unwrap(), expected);
        assert!(console.out.is_empty());
    }

    #[test]
    fn live_line_is_printed_periodically_without_a_terminal() {
        let mut console = Console::new(Vec::new(), Vec::new(), None);
        let start = Instant::now();
        for second in 0..11 {
            let text = format!("\r{second}");
            console
                .line(
                    "monitor-1",
                    Stream::Out,
                    &text,
                    start + Duration::from_secs(second),
                )
                .unwrap();
        }
        assert_eq!(
            String::from_utf8(console.err).unwrap(),
            "[monitor-1] 0\n[monitor-1] 5\n[monitor-1] 10\n"
        );
    }
}
