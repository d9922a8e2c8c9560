use std::fmt;

use crate::judges::{Error, Result};

/// Shorter keys are placeholders of local servers, such as `none`, and may be words of an answer.
const MIN_SECRET_BYTES: usize = 8;
const REDACTED: &str = "[API key]";

/// An API key that is never printed.
pub(super) struct ApiKey(String);

impl ApiKey {
    /// Reads the key from the environment.
    pub(super) fn from_environment(judge: &str, variable: &str) -> Result<Self> {
        let failed = |problem| Error::ApiKey {
            judge: judge.to_owned(),
            variable: variable.to_owned(),
            problem,
        };
        let value = std::env::var_os(variable).ok_or_else(|| failed("is not set"))?;
        let value = value.into_string().ok();
        // A key read from a file often ends with a newline.
        let key = value.as_deref().map(str::trim).unwrap_or_default();
        if key.is_empty() {
            return Err(failed("is empty or not text"));
        }
        if !key.bytes().all(|b| b.is_ascii_graphic()) {
            return Err(failed("has characters that no HTTP header may have"));
        }
        Ok(Self(key.to_owned()))
    }

    pub(super) fn authorization(&self) -> String {
        format!("Bearer {}", self.0)
    }

    /// Removes the key from a server's text: some servers quote a rejected key.
    pub(super) fn redact(&self, text: String) -> String {
        if self.0.len() < MIN_SECRET_BYTES || !text.contains(&self.0) {
            return text;
        }
        text.replace(&self.0, REDACTED)
    }
}

impl fmt::Debug for ApiKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(REDACTED)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn key_is_read_from_the_environment_and_not_printed() {
        // Set by cargo, also for tests.
        let key = ApiKey::from_environment("a", "CARGO_PKG_NAME").unwrap();
        assert_eq!(key.authorization(), "Bearer wm_evaluation");
        assert_eq!(format!("{key:?}"), "[API key]");
        let error = ApiKey::from_environment("a", "WM_JUDGE_NO_SUCH_VARIABLE").unwrap_err();
        assert!(
            error
                .to_string()
                .contains("WM_JUDGE_NO_SUCH_VARIABLE is not set"),
            "{error}"
        );
    }

    #[test]
    fn key_is_redacted_from_texts() {
        let key = ApiKey("sk-0123456789".to_owned());
        assert_eq!(
            key.redact("wrong: sk-0123456789!".to_owned()),
            "wrong: [API key]!"
        );
        let key = ApiKey("1".to_owned());
        assert_eq!(key.redact("Final Score: 1".to_owned()), "Final Score: 1");
    }
}
