use std::fmt;

use crate::judges::{Error, Result};

/// Shorter ones are placeholders of local servers, as `none`, and too likely to be words of an answer.
const MIN_SECRET_BYTES: usize = 8;
const REDACTED: &str = "[API key]";

/// An API key. Nothing prints it.
pub(super) struct ApiKey(String);

impl ApiKey {
    /// Takes the key from the environment.
    pub(super) fn from_environment(judge: &str, variable: &str) -> Result<Self> {
        let failed = |problem| Error::ApiKey {
            judge: judge.to_owned(),
            variable: variable.to_owned(),
            problem,
        };
        let value = std::env::var_os(variable).ok_or_else(|| failed("is not set"))?;
        let value = value.into_string().ok();
        // A line end behind the key is how it comes out of a file.
        let key = value.as_deref().map(str::trim).unwrap_or_default();
        if key.is_empty() {
            return Err(failed("is empty or no text"));
        }
        if !key.bytes().all(|b| b.is_ascii_graphic()) {
            return Err(failed("has characters that no HTTP header may have"));
        }
        Ok(Self(key.to_owned()))
    }

    pub(super) fn authorization(&self) -> String {
        format!("Bearer {}", self.0)
    }

    /// Takes the key out of what a server says: some quote it when they refuse it.
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
    fn it_is_taken_from_the_environment_and_not_printed() {
        // Set by cargo, for tests too.
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
    fn it_is_taken_out_of_texts() {
        let key = ApiKey("sk-0123456789".to_owned());
        assert_eq!(
            key.redact("wrong: sk-0123456789!".to_owned()),
            "wrong: [API key]!"
        );
        let key = ApiKey("1".to_owned());
        assert_eq!(key.redact("Final Score: 1".to_owned()), "Final Score: 1");
    }
}
