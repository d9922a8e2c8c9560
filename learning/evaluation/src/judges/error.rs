use std::{io, path::PathBuf};

/// Result of this module's functions.
pub type Result<T> = std::result::Result<T, Error>;

/// Errors, except unusable answers: these are a [`crate::judges::verdict::VerdictError`], and are kept.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    // Files of settings.
    /// A file cannot be read.
    #[error("{}: {source}", path.display())]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Cause.
        source: io::Error,
    },
    /// A file that is too large.
    #[error("{} is larger than {limit} bytes, which no file of settings is", path.display())]
    FileTooLarge {
        /// Path of the file.
        path: PathBuf,
        /// Limit \[bytes\].
        limit: u64,
    },
    /// Invalid YAML.
    #[error("not {what}: {source}")]
    Yaml {
        /// Expected content.
        what: &'static str,
        /// Fault.
        source: serde_yaml_ng::Error,
    },
    /// A prompt with an unknown placeholder.
    #[error(
        "the prompt {prompt:?} has the unknown placeholder {{{found}}}, expected one of {expected:?}"
    )]
    UnknownPlaceholder {
        /// Key of the prompt.
        prompt: &'static str,
        /// The placeholder.
        found: String,
        /// Accepted placeholders.
        expected: Vec<&'static str>,
    },
    /// A prompt without a required placeholder.
    #[error("the prompt {prompt:?} lacks the placeholder {{{expected}}}")]
    MissingPlaceholder {
        /// Key of the prompt.
        prompt: &'static str,
        /// The placeholder.
        expected: &'static str,
    },
    /// An invalid task.
    #[error("the task {instruction:?}: {problem}")]
    Task {
        /// Instruction of the task.
        instruction: String,
        /// Fault and expectation.
        problem: String,
    },
    /// An invalid setting.
    #[error("{owner}: {setting} is {found}, expected {expected}")]
    Setting {
        /// The judge, or a part of the file.
        owner: String,
        /// Key of the setting.
        setting: &'static str,
        /// Value.
        found: String,
        /// Accepted values.
        expected: &'static str,
    },
    /// An https endpoint in a build without TLS.
    #[error("judge {judge}: {base_url} needs TLS; build with the feature `https` of wm_evaluation")]
    NeedsHttps {
        /// Name of the judge.
        judge: String,
        /// Address of its endpoint.
        base_url: String,
    },
    /// The API key is missing or invalid. The error never contains the key.
    #[error("judge {judge}: the environment variable {variable} {problem}, expected an API key")]
    ApiKey {
        /// Name of the judge.
        judge: String,
        /// Environment variable.
        variable: String,
        /// Fault.
        problem: &'static str,
    },

    // Questions.
    /// A rollout without frames.
    #[error("a rollout of {instruction:?} has no frames, expected at least one")]
    NoFrames {
        /// Instruction of the rollout.
        instruction: String,
    },
    /// A frame that cannot be encoded.
    #[error("frame {frame} of {width}x{height} pixels: {problem}")]
    Picture {
        /// Index of the frame.
        frame: usize,
        /// Width \[px\].
        width: u32,
        /// Height \[px\].
        height: u32,
        /// Message of the encoder.
        problem: String,
    },

    // Endpoints.
    /// The server rejected a question permanently.
    #[error(
        "judge {judge}: the server rejected the question with status {status}, expected 200: {message}"
    )]
    Rejected {
        /// Name of the judge.
        judge: String,
        /// HTTP status.
        status: u16,
        /// Excerpt of the server's message.
        message: String,
    },
    /// No answer after all retries.
    #[error("judge {judge}: no answer after {attempts} attempts: {last}")]
    GaveUp {
        /// Name of the judge.
        judge: String,
        /// Number of requests.
        attempts: u32,
        /// Failure of the last request.
        last: String,
    },
    /// The server requests too long a wait.
    #[error(
        "judge {judge}: the server requests a wait of {wait_s} s, expected at most {limit_s} s: {last}"
    )]
    WaitTooLong {
        /// Name of the judge.
        judge: String,
        /// Requested wait \[s\].
        wait_s: u64,
        /// Longest wait \[s\].
        limit_s: u64,
        /// Failure of the request.
        last: String,
    },
    /// An answer that is too large.
    #[error("judge {judge}: the server's answer is larger than {limit} bytes, which no verdict is")]
    BodyTooLarge {
        /// Name of the judge.
        judge: String,
        /// Limit \[bytes\].
        limit: u64,
    },
    /// A request that cannot be sent.
    #[error("judge {judge}: {problem}")]
    Request {
        /// Name of the judge.
        judge: String,
        /// Message of the client.
        problem: String,
    },
    /// The next question may exceed the cost limit. Earlier answers are kept.
    #[error(
        "judge {judge}: {spent:.4} spent, the next question may cost {next:.4}, and max_cost is {cap:.4}; the answers so \
         far are kept"
    )]
    CostCap {
        /// Name of the judge.
        judge: String,
        /// Cost of all answers in the record.
        spent: f64,
        /// Greatest cost of the next answer.
        next: f64,
        /// Limit.
        cap: f64,
    },
    /// A cost limit that cannot be checked.
    #[error(
        "judge {judge}: {answers} answers lack `usage`, so max_cost cannot be checked; the answers so far are kept"
    )]
    UsageMissing {
        /// Name of the judge.
        judge: String,
        /// Number of answers.
        answers: u64,
    },

    // Records.
    /// The file is not a record, and is left unchanged.
    #[error("{} is not a record of answers: the first line is not {expected}", path.display())]
    NotARecord {
        /// Path of the file.
        path: PathBuf,
        /// Expected first line.
        expected: &'static str,
    },
    /// A damaged line of the record.
    #[error("{}, line {line}: {source}", path.display())]
    RecordLine {
        /// Path of the file.
        path: PathBuf,
        /// Number from 1.
        line: u64,
        /// Fault.
        source: serde_json::Error,
    },
    /// A line of the record that is too long.
    #[error("{}, line {line}: longer than {limit} bytes, which no answer is", path.display())]
    RecordLineTooLong {
        /// Path of the file.
        path: PathBuf,
        /// Number from 1.
        line: u64,
        /// Limit \[bytes\].
        limit: u64,
    },
    /// The record is open in another process.
    #[error("{} is in use by another process", path.display())]
    RecordInUse {
        /// Path of the file.
        path: PathBuf,
    },
    /// The record cannot be read or written.
    #[error("the record {}: {source}", path.display())]
    Record {
        /// Path of the file.
        path: PathBuf,
        /// Cause.
        source: io::Error,
    },
}
