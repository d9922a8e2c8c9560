//! Downloads with resumption and verification.
//!
//! A download resumes only if the server confirms by the entity tag that the file is the same. The final check is the
//! hash: the one recorded by an earlier download, or the one that the server states.

mod part;

use anyhow::{Context as _, Result, bail, ensure};
use part::{Part, Start, strong_etag};
use sha2::{Digest as _, Sha256};
use std::fmt::Write as _;
use std::fs::File;
use std::io::{Read, Write};
use std::path::Path;
use std::time::Duration;
use ureq::config::ConfigBuilder;
use ureq::http::{
    HeaderMap, Response, StatusCode,
    header::{CONTENT_RANGE, ETAG},
};
use ureq::typestate::AgentScope;
use ureq::{Agent, Body};
use wm_program::progress::Progress;

/// How long a server may take to reply.
const ANSWER_WITHIN: Duration = Duration::from_secs(30);
/// Bytes read at once.
const CHUNK: usize = 1 << 20;
/// A larger file is not a usable model, and would fill the disk.
const MAX_BYTES: u64 = 64 << 30;

/// The header with which Hugging Face states the hash of a large file, in the redirect to it.
const LINKED_ETAG: &str = "x-linked-etag";
/// The header with which Hugging Face states the commit of a branch or tag.
const REPO_COMMIT: &str = "x-repo-commit";

/// A client for downloads.
pub struct Client {
    agent: Agent,
    /// For Hugging Face; not sent to redirect targets.
    token: Option<String>,
}

/// A file to download.
pub struct Request<'a> {
    pub url: &'a str,
    pub path: &'a Path,
    /// SHA-256 that the server states.
    pub stated: Option<&'a str>,
    /// SHA-256 of an earlier download.
    pub pinned: Option<&'a str>,
    /// Whether to replace a different file at `path`, or accept a different file than pinned.
    pub overwrite: bool,
}

impl Request<'_> {
    /// The required hash, if known.
    fn expected(&self) -> Result<Option<&str>> {
        match (self.pinned.filter(|_| !self.overwrite), self.stated) {
            (Some(pinned), Some(stated)) if pinned != stated => bail!(
                "the server's file differs from the one recorded in fetched.json: SHA-256 {stated}, expected {pinned}; \
                 --overwrite accepts it"
            ),
            (pinned, stated) => Ok(pinned.or(stated)),
        }
    }
}

/// Properties of a file that a server states before it sends it.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct FileProperties {
    /// SHA-256 of a large file on Hugging Face.
    pub sha256: Option<String>,
    /// The commit of the requested revision on Hugging Face.
    pub commit: Option<String>,
}

impl Client {
    /// A client that sends `token` to Hugging Face.
    pub fn new(token: Option<String>) -> Self {
        Self {
            agent: settings().https_only(true).build().into(),
            token,
        }
    }

    /// Downloads a file and returns its SHA-256. Resumes from [`Part`] if the server still has the same file. A
    /// complete file is only checked; a different one is an error unless it may be replaced.
    pub fn fetch(&self, request: &Request<'_>) -> Result<String> {
        let expected = request.expected()?;
        let path = request.path;
        if path.exists() {
            let found = hex(&hash_file(path)?.0);
            match expected {
                Some(expected) if expected == found => return Ok(found),
                _ if request.overwrite => {}
                None => return Ok(found),
                Some(expected) => bail!(
                    "{} exists and is a different file: SHA-256 {found}, expected {expected}; --overwrite replaces it",
                    path.display()
                ),
            }
        }
        let part = Part::of(path);
        let found = self.receive(request.url, &part)?;
        if let Some(expected) = expected
            && expected != found
        {
            // to resume from wrong bytes would never end
            part.discard()?;
            bail!(
                "not the expected file, or damaged in transfer: SHA-256 {found}, expected {expected}; it was removed"
            );
        }
        part.finish(path)?;
        Ok(found)
    }

    pub fn stated(&self, url: &str) -> Result<FileProperties> {
        let mut request = self.agent.head(url);
        if let Some(token) = &self.token {
            request = request.header("Authorization", format!("Bearer {token}"));
        }
        let answer = request.config().max_redirects(0).build().call();
        let answer = answer.context("no answer: is there a network?")?;
        if !answer.status().is_redirection() {
            check_status(&answer)?;
        }
        Ok(FileProperties {
            sha256: linked_sha256(answer.headers()),
            commit: commit(answer.headers()),
        })
    }

    /// Requests the file, or the rest after `start` of the same version.
    fn get(&self, url: &str, start: &Start) -> Result<Response<Body>> {
        let mut request = self.agent.get(url);
        if let Some(token) = &self.token {
            request = request.header("Authorization", format!("Bearer {token}"));
        }
        if start.have > 0 {
            request = request
                .header("Range", format!("bytes={}-", start.have))
                .header("If-Range", &start.etag);
        }
        request.call().context("no answer: is there a network?")
    }

    /// Receives the rest after `part`, and returns the hash of the whole.
    fn receive(&self, url: &str, part: &Part) -> Result<String> {
        let mut start = part.start()?;
        let mut answer = self.get(url, &start)?;
        if start.have > 0 {
            match Resumption::of(&answer, &start) {
                Resumption::Rest => {}
                Resumption::Complete => return Ok(hex(&start.hash)),
                Resumption::Whole => start = Start::default(),
                Resumption::Unfit => {
                    start = Start::default();
                    answer = self.get(url, &start)?;
                }
            }
        }
        check_status(&answer)?;
        let Start {
            mut hash, mut have, ..
        } = start;
        // without a range request the whole file has to come
        ensure!(
            have > 0 || answer.status() == StatusCode::OK,
            "the server answered {}",
            answer.status()
        );
        let rest = answer.body().content_length();
        let total = rest.map(|rest| rest + have);
        ensure!(
            total.is_none_or(|total| total <= MAX_BYTES),
            "the file has {} bytes, expected at most {MAX_BYTES}",
            total.unwrap_or_default()
        );
        let mut file = match have {
            0 => part.begin(strong_etag(answer.headers()))?,
            _ => part.resume()?,
        };
        let part = part.path();
        let name = part.file_stem().unwrap_or_default().to_string_lossy();
        let progress = match total {
            Some(total) => Progress::of(&name, "bytes", total),
            None => Progress::open_ended(&name, "bytes"),
        };
        progress.resume_at(have);
        let mut reader = answer.body_mut().with_config().limit(MAX_BYTES).reader();
        let mut chunk = vec![0; CHUNK];
        loop {
            let count = reader.read(&mut chunk).with_context(|| {
                format!("interrupted after {have} bytes; run the command again to resume")
            })?;
            let Some(received) = chunk.get(..count).filter(|received| !received.is_empty()) else {
                break;
            };
            hash.update(received);
            file.write_all(received)
                .with_context(|| part.display().to_string())?;
            have += count as u64;
            progress.inc(count as u64);
        }
        drop(progress);
        file.sync_all()
            .with_context(|| part.display().to_string())?;
        if let Some(total) = total {
            ensure!(
                have == total,
                "the server sent {have} of {total} bytes; run the command again to resume"
            );
        }
        Ok(hex(&hash))
    }
}

fn settings() -> ConfigBuilder<AgentScope> {
    Agent::config_builder()
        // status codes are handled here
        .http_status_as_error(false)
        .timeout_connect(Some(ANSWER_WITHIN))
        .timeout_recv_response(Some(ANSWER_WITHIN))
}

/// The content of a response to a request for the rest of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Resumption {
    Rest,
    /// Nothing: the part is already complete, for example after an interruption before the rename.
    Complete,
    /// The whole file, because it has changed or the server does not support ranges; or an error.
    Whole,
    /// Another range, or a range of another file.
    Unfit,
}

impl Resumption {
    fn of(answer: &Response<Body>, start: &Start) -> Self {
        let headers = answer.headers();
        let is_same = headers
            .get(ETAG)
            .is_none_or(|etag| etag.as_bytes() == start.etag.as_bytes());
        let range = headers.get(CONTENT_RANGE);
        let range = range.and_then(|range| range.to_str().ok()?.strip_prefix("bytes "));
        // `FIRST-LAST/LENGTH`, or `*/LENGTH` for an unsatisfiable range: RFC 9110, section 14.4.
        let (first, length) = match range.and_then(|range| range.split_once('/')) {
            Some((range, length)) => (range.split('-').next(), length.parse().ok()),
            None => (None, None),
        };
        let begins_here = first.and_then(|first| first.parse().ok()) == Some(start.have);
        match answer.status() {
            StatusCode::PARTIAL_CONTENT if is_same && begins_here => Self::Rest,
            StatusCode::RANGE_NOT_SATISFIABLE if is_same && length == Some(start.have) => {
                Self::Complete
            }
            StatusCode::PARTIAL_CONTENT | StatusCode::RANGE_NOT_SATISFIABLE => Self::Unfit,
            _ => Self::Whole,
        }
    }
}

fn check_status(answer: &Response<Body>) -> Result<()> {
    let status = answer.status();
    match status.as_u16() {
        200..=299 => Ok(()),
        401 | 403 => bail!("access denied ({status})"),
        404 => bail!("the file does not exist ({status})"),
        _ => bail!("the server answers {status}"),
    }
}

/// The SHA-256 in Hugging Face's header; small files have another kind of hash there.
fn linked_sha256(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(LINKED_ETAG)?.to_str().ok()?;
    let value = value.trim_start_matches("W/").trim_matches('"');
    let is_sha256 = value.len() == 64 && value.bytes().all(|byte| byte.is_ascii_hexdigit());
    is_sha256.then(|| value.to_ascii_lowercase())
}

/// The commit in Hugging Face's header. It becomes part of an address, so anything but a hash is ignored.
fn commit(headers: &HeaderMap) -> Option<String> {
    let value = headers.get(REPO_COMMIT)?.to_str().ok()?;
    let is_hash = value.len() == 40 && value.bytes().all(|byte| byte.is_ascii_hexdigit());
    is_hash.then(|| value.to_owned())
}

fn hash_file(path: &Path) -> Result<(Sha256, u64)> {
    let mut file = File::open(path).with_context(|| path.display().to_string())?;
    let mut hash = Sha256::new();
    let length = std::io::copy(&mut file, &mut hash).with_context(|| path.display().to_string())?;
    Ok((hash, length))
}

fn hex(hash: &Sha256) -> String {
    let mut text = String::new();
    for byte in hash.clone().finalize() {
        // writing to a string does not fail
        write!(text, "{byte:02x}").ok();
    }
    text
}

#[cfg(test)]
mod tests;
