//! All answers, on disk.

mod entry;
mod key;

use std::{
    collections::HashMap,
    fs::{File, OpenOptions, TryLockError},
    io::{self, BufRead as _, BufReader, Read as _, Seek as _, SeekFrom, Write as _},
    path::{Path, PathBuf},
};

use tracing::warn;

use crate::judges::{Error, Result, endpoint::Usage};

pub use entry::{Answer, Entry, Outcome};
pub(crate) use key::question_key;

/// First line of a record, which identifies the file.
pub const HEADER: &str = "{\"wm_judge_record\":1}";
/// More than the answers to one question: 11 of [`MAX_BODY_BYTES`](crate::judges::endpoint::MAX_BODY_BYTES), and the request.
const MAX_LINE_BYTES: u64 = 128 << 20;

/// A file of JSON lines: [`HEADER`], then an [`Entry`] per question. Each line is on disk before the next question is
/// sent.
///
/// Reopening the file resumes: answered questions are not sent again, interrupted ones are. Only keys, verdicts and
/// token sums are in memory.
#[derive(Debug)]
pub struct Record {
    path: PathBuf,
    file: File,
    /// Length of the complete lines.
    bytes: u64,
    outcomes: HashMap<String, Outcome>,
    tallies: HashMap<String, Tally>,
}

/// Consumption of a judge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Tally {
    /// Tokens of all answers.
    pub usage: Usage,
    /// Greatest input and greatest output of one answer.
    pub largest: Usage,
    /// Answers whose tokens are unknown.
    pub uncounted: u64,
    /// Questions without a usable answer.
    pub unusable: u64,
}

impl Tally {
    pub(crate) fn add(&mut self, answer: &Answer) {
        let Some(usage) = answer.usage else {
            self.uncounted += 1;
            return;
        };
        self.usage.add(usage);
        self.largest.input_tokens = self.largest.input_tokens.max(usage.input_tokens);
        self.largest.output_tokens = self.largest.output_tokens.max(usage.output_tokens);
    }
}

impl Record {
    /// Opens or creates a record. An incomplete last line of a killed process is dropped with a warning.
    ///
    /// # Errors
    /// If the file is not a record, has a damaged line, is open in another process, or cannot be read or written. It is
    /// then unchanged.
    pub fn open(path: &Path) -> Result<Self> {
        let failed = |source| Error::Record {
            path: path.to_owned(),
            source,
        };
        let mut options = OpenOptions::new();
        let options = options.read(true).append(true).create(true);
        let file = options.open(path).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(Error::RecordInUse {
                    path: path.to_owned(),
                });
            }
            Err(TryLockError::Error(source)) => return Err(failed(source)),
        }
        let mut record = Self {
            path: path.to_owned(),
            file,
            bytes: 0,
            outcomes: HashMap::new(),
            tallies: HashMap::new(),
        };
        let length = record.file.metadata().map_err(failed)?.len();
        record.read_lines()?;
        if record.bytes < length {
            let torn = length - record.bytes;
            warn!(path = %path.display(), bytes = torn, "dropping the incomplete last line");
            record.file.set_len(record.bytes).map_err(failed)?;
        }
        if record.bytes == 0 {
            record.write_line(HEADER).map_err(failed)?;
        }
        Ok(record)
    }

    /// Path of the file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Outcome of the question with this key; `None` if it was never sent, or was interrupted.
    #[must_use]
    pub fn outcome(&self, key: &str) -> Option<&Outcome> {
        self.outcomes.get(key)
    }

    /// Number of answered questions.
    #[must_use]
    pub fn len(&self) -> usize {
        self.outcomes.len()
    }

    /// Whether no question is answered.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.outcomes.is_empty()
    }

    /// Consumption of a judge in all runs.
    #[must_use]
    pub fn tally(&self, judge: &str) -> Tally {
        self.tallies.get(judge).copied().unwrap_or_default()
    }

    /// Appends a question with its answers.
    ///
    /// # Errors
    /// If the file cannot be written. Its earlier content stays.
    pub fn append(&mut self, entry: Entry) -> Result<()> {
        let line = serde_json::to_string(&entry);
        let written = line
            .map_err(Into::into)
            .and_then(|line| self.write_line(&line));
        written.map_err(|source| Error::Record {
            path: self.path.clone(),
            source,
        })?;
        self.remember(entry);
        Ok(())
    }

    fn write_line(&mut self, line: &str) -> io::Result<()> {
        let line = format!("{line}\n");
        let written = self.file.write_all(line.as_bytes());
        if let Err(error) = written.and_then(|()| self.file.sync_data()) {
            // Half a line would damage the next one. If truncation fails too, reopening drops the incomplete line.
            self.file.set_len(self.bytes).ok();
            return Err(error);
        }
        self.bytes += line.len() as u64;
        Ok(())
    }

    fn remember(&mut self, entry: Entry) {
        let tally = self.tallies.entry(entry.judge).or_default();
        for answer in &entry.answers {
            tally.add(answer);
        }
        match entry.outcome {
            // Sent again after reopening.
            Outcome::Interrupted(_) => return,
            Outcome::Unusable(_) => tally.unusable += 1,
            Outcome::Success(_) | Outcome::Rubric(_) => {}
        }
        self.outcomes.insert(entry.key, entry.outcome);
    }

    fn read_lines(&mut self) -> Result<()> {
        let path = self.path.clone();
        let failed = |source| Error::Record {
            path: path.clone(),
            source,
        };
        let mut file = self.file.try_clone().map_err(failed)?;
        file.seek(SeekFrom::Start(0)).map_err(failed)?;
        let mut lines = BufReader::new(file);
        let mut line = Vec::new();
        for number in 1_u64.. {
            line.clear();
            // The first line identifies the file; read no more if it is another.
            let limit = if number == 1 {
                HEADER.len() as u64 + 1
            } else {
                MAX_LINE_BYTES
            };
            let mut limited = lines.by_ref().take(limit);
            limited.read_until(b'\n', &mut line).map_err(failed)?;
            let whole = line.strip_suffix(b"\n");
            let header = HEADER.as_bytes();
            match whole {
                Some(text) if number == 1 && text == header => {}
                None if number == 1 && header.starts_with(&line) => return Ok(()),
                _ if number == 1 => {
                    return Err(Error::NotARecord {
                        path,
                        expected: HEADER,
                    });
                }
                None if line.len() as u64 == limit => {
                    return Err(Error::RecordLineTooLong {
                        path,
                        line: number,
                        limit,
                    });
                }
                None => return Ok(()),
                Some(text) => {
                    let entry = serde_json::from_slice(text);
                    let entry = entry.map_err(|source| Error::RecordLine {
                        path: path.clone(),
                        line: number,
                        source,
                    })?;
                    self.remember(entry);
                }
            }
            self.bytes += line.len() as u64;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests;
