use std::{io, path::PathBuf};

/// The result of this crate's functions.
pub type Result<T> = std::result::Result<T, Error>;

/// What can go wrong, but for an answer that says nothing usable: that is [`crate::judges::verdict::VerdictError`], and kept.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    // Files of settings.
    /// A file cannot be read.
    #[error("{}: {source}", path.display())]
    File {
        /// Which.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file is too large for what it should be.
    #[error("{} is larger than {limit} bytes, which no file of settings is", path.display())]
    FileTooLarge {
        /// Which.
        path: PathBuf,
        /// Bytes that it may have.
        limit: u64,
    },
    /// YAML that is not what it should be.
    #[error("not {what}: {source}")]
    Yaml {
        /// What it should be.
        what: &'static str,
        /// Where it is not.
        source: serde_yaml_ng::Error,
    },
    /// A prompt with a placeholder that means nothing there.
    #[error("the prompt {prompt:?} has the placeholder {{{found}}}, which is none of {expected:?}")]
    UnknownPlaceholder {
        /// The prompt's key in the file.
        prompt: &'static str,
        /// The placeholder.
        found: String,
        /// What the prompt may have.
        expected: Vec<&'static str>,
    },
    /// A prompt without a placeholder that it needs.
    #[error("the prompt {prompt:?} lacks the placeholder {{{expected}}}")]
    MissingPlaceholder {
        /// The prompt's key in the file.
        prompt: &'static str,
        /// The placeholder.
        expected: &'static str,
    },
    /// A task that contradicts its file.
    #[error("the task {instruction:?}: {problem}")]
    Task {
        /// Its instruction.
        instruction: String,
        /// What is wrong, and what was expected.
        problem: String,
    },
    /// A setting that cannot be.
    #[error("{owner}: {setting} is {found}, expected {expected}")]
    Setting {
        /// The judge, or the part of the file.
        owner: String,
        /// The setting's key.
        setting: &'static str,
        /// Its value.
        found: String,
        /// What it may be.
        expected: &'static str,
    },
    /// An endpoint behind https, in a build without TLS.
    #[error(
        "judge {judge}: {base_url} takes TLS, which is not built in: build with the feature `https` of wm_evaluation"
    )]
    NeedsHttps {
        /// The judge.
        judge: String,
        /// Its endpoint.
        base_url: String,
    },
    /// The API key is not where the settings say. Never has the key in it.
    #[error("judge {judge}: the environment variable {variable} {problem}, expected an API key")]
    ApiKey {
        /// The judge.
        judge: String,
        /// The variable.
        variable: String,
        /// What is wrong with it.
        problem: &'static str,
    },

    // Questions.
    /// A rollout without frames.
    #[error("a rollout of {instruction:?} has no frames, expected at least one")]
    NoFrames {
        /// Its instruction.
        instruction: String,
    },
    /// A frame that cannot be encoded.
    #[error("frame {frame} of {width}x{height} pixels: {problem}")]
    Picture {
        /// Its place among the frames.
        frame: usize,
        /// In pixels.
        width: u32,
        /// In pixels.
        height: u32,
        /// What the encoder says.
        problem: String,
    },

    // Endpoints.
    /// The server refused a question; asking it again would not help.
    #[error("judge {judge}: the server refused with status {status}, expected 200: {message}")]
    Refused {
        /// The judge.
        judge: String,
        /// HTTP status.
        status: u16,
        /// An excerpt of what the server says.
        message: String,
    },
    /// No answer, however often it was asked for.
    #[error("judge {judge}: no answer after {attempts} attempts: {last}")]
    GaveUp {
        /// The judge.
        judge: String,
        /// Requests that were sent.
        attempts: u32,
        /// Why the last of them failed.
        last: String,
    },
    /// The server wants more patience than a run has.
    #[error(
        "judge {judge}: the server asks to wait for {wait_s} s, expected at most {limit_s} s: {last}"
    )]
    WaitTooLong {
        /// The judge.
        judge: String,
        /// Seconds that it asks for.
        wait_s: u64,
        /// Seconds that are waited for at most.
        limit_s: u64,
        /// Why the request failed.
        last: String,
    },
    /// An answer that does not end.
    #[error("judge {judge}: the server's answer is larger than {limit} bytes, which no verdict is")]
    BodyTooLarge {
        /// The judge.
        judge: String,
        /// Bytes that it may have.
        limit: u64,
    },
    /// A request that cannot be sent at all.
    #[error("judge {judge}: {problem}")]
    Request {
        /// The judge.
        judge: String,
        /// What the client says.
        problem: String,
    },
    /// The next question might pass the cap of costs. The answers so far are kept.
    #[error(
        "judge {judge}: {spent:.4} spent, the next question may cost {next:.4}, and max_cost is {cap:.4}; the answers so \
         far are kept"
    )]
    CostCap {
        /// The judge.
        judge: String,
        /// By all answers in the record.
        spent: f64,
        /// At most, by the next.
        next: f64,
        /// The cap.
        cap: f64,
    },
    /// A cap of costs that cannot be held.
    #[error(
        "judge {judge}: {answers} answers came without `usage`, so max_cost cannot be held; the answers so far are kept"
    )]
    UsageMissing {
        /// The judge.
        judge: String,
        /// How many.
        answers: u64,
    },

    // Records.
    /// The file is something else, and is left alone.
    #[error("{} is no record of answers: its first line is not {expected}", path.display())]
    NotARecord {
        /// The file.
        path: PathBuf,
        /// What the first line of a record is.
        expected: &'static str,
    },
    /// A line of the record is damaged.
    #[error("{}, line {line}: {source}", path.display())]
    RecordLine {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: u64,
        /// What is wrong with it.
        source: serde_json::Error,
    },
    /// A line of the record is too long.
    #[error("{}, line {line}: longer than {limit} bytes, which no answer is", path.display())]
    RecordLineTooLong {
        /// The file.
        path: PathBuf,
        /// Counted from 1.
        line: u64,
        /// Bytes that it may have.
        limit: u64,
    },
    /// Another process writes to the record.
    #[error("{} is in use by another process", path.display())]
    RecordInUse {
        /// The file.
        path: PathBuf,
    },
    /// The record cannot be read or written.
    #[error("the record {}: {source}", path.display())]
    Record {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}
