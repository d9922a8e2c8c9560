use std::{io::Read as _, sync::Arc, time::Duration};

use serde_json::Value;
use tracing::warn;
use ureq::{
    Agent, Body,
    http::{Response, header::RETRY_AFTER},
};

use super::{
    Clock, EndpointSettings, Reply, SystemClock, api_key::ApiKey, backoff, completion, pace::Pace,
};
use crate::judges::{Error, Result, excerpt::excerpt};

/// Largest accepted answer of a server.
pub const MAX_BODY_BYTES: u64 = 8 << 20;

/// A client of one server.
#[derive(Debug)]
pub struct Client {
    settings: EndpointSettings,
    agent: Agent,
    url: String,
    key: Option<ApiKey>,
    pace: Pace,
    clock: Arc<dyn Clock>,
}

/// A failure that may be retried.
struct Failure {
    cause: String,
    retry_after: Option<Duration>,
}

impl Failure {
    fn new(cause: impl Into<String>) -> Self {
        Self {
            cause: cause.into(),
            retry_after: None,
        }
    }
}

impl Client {
    /// A client for the settings' endpoint. Sends nothing yet.
    ///
    /// # Errors
    /// If a setting is invalid, or the environment lacks the API key.
    pub fn new(settings: EndpointSettings) -> Result<Self> {
        Self::with_clock(settings, Arc::new(SystemClock::default()))
    }

    /// [`Self::new`] with another clock.
    ///
    /// # Errors
    /// Those of [`Self::new`].
    pub fn with_clock(settings: EndpointSettings, clock: Arc<dyn Clock>) -> Result<Self> {
        settings.check()?;
        let variable = settings.api_key_env.as_deref();
        let key = variable.map(|variable| ApiKey::from_environment(&settings.name, variable));
        let config = Agent::config_builder()
            .timeout_global(Some(Duration::from_secs(settings.timeout_s)))
            .http_status_as_error(false)
            // A redirected POST loses its body.
            .max_redirects(0)
            // The environment must not redirect questions.
            .proxy(None)
            .user_agent(concat!("wm_judge/", env!("CARGO_PKG_VERSION")))
            .build();
        Ok(Self {
            agent: config.into(),
            url: format!(
                "{}/chat/completions",
                settings.base_url.trim_end_matches('/')
            ),
            key: key.transpose()?,
            pace: Pace::new(settings.requests_per_minute, settings.tokens_per_minute),
            settings,
            clock,
        })
    }

    /// Settings of the client.
    #[must_use]
    pub fn settings(&self) -> &EndpointSettings {
        &self.settings
    }

    /// Sends a request, with retries, and returns the answer. Retried are broken or refused connections, timeouts,
    /// statuses 408, 409, 429 and 5xx, and bodies without a chat completion. Waits double from a second to a minute,
    /// reduced by up to half by `jitter_seed`, or follow the server.
    ///
    /// # Errors
    /// If the server rejects the request, never answers, or requests a wait above ten minutes.
    pub fn ask(&mut self, request: &Value, jitter_seed: u64) -> Result<Reply> {
        let body = request.to_string();
        let mut retry = 0;
        loop {
            self.pace.wait(self.clock.as_ref());
            let failure = match self.send(&body)? {
                Ok(mut reply) => {
                    reply.attempts = retry + 1;
                    if let Some(usage) = reply.usage {
                        self.pace
                            .took(usage.input_tokens.saturating_add(usage.output_tokens));
                    }
                    return Ok(reply);
                }
                Err(failure) => failure,
            };
            let judge = &self.settings.name;
            if retry == self.settings.retries {
                return Err(Error::GaveUp {
                    judge: judge.clone(),
                    attempts: retry + 1,
                    last: failure.cause,
                });
            }
            let wait = failure.retry_after;
            let wait = wait.unwrap_or_else(|| backoff::delay(retry, jitter_seed));
            if wait > backoff::MAX_RETRY_AFTER {
                return Err(Error::WaitTooLong {
                    judge: judge.clone(),
                    wait_s: wait.as_secs(),
                    limit_s: backoff::MAX_RETRY_AFTER.as_secs(),
                    last: failure.cause,
                });
            }
            warn!(
                judge,
                cause = failure.cause,
                wait_s = wait.as_secs_f32(),
                "retrying"
            );
            self.clock.sleep(wait);
            retry += 1;
        }
    }

    fn send(&self, body: &str) -> Result<std::result::Result<Reply, Failure>> {
        let mut request = self.agent.post(&self.url).content_type("application/json");
        if let Some(key) = &self.key {
            request = request.header("Authorization", key.authorization());
        }
        match request.send(body) {
            Ok(response) => self.receive(response),
            Err(error) if may_pass(&error) => Ok(Err(Failure::new(self.quote(error.to_string())))),
            Err(error) => Err(Error::Request {
                judge: self.settings.name.clone(),
                problem: self.quote(error.to_string()),
            }),
        }
    }

    fn receive(&self, mut response: Response<Body>) -> Result<std::result::Result<Reply, Failure>> {
        let status = response.status().as_u16();
        let header = response.headers().get(RETRY_AFTER);
        let header = header.and_then(|value| value.to_str().ok());
        let retry_after = header.and_then(|value| backoff::retry_after(value, self.clock.unix_s()));
        let mut bytes = Vec::new();
        let reader = response.body_mut().as_reader();
        let read = reader.take(MAX_BODY_BYTES + 1).read_to_end(&mut bytes);
        if bytes.len() as u64 > MAX_BODY_BYTES {
            return Err(Error::BodyTooLarge {
                judge: self.settings.name.clone(),
                limit: MAX_BODY_BYTES,
            });
        }
        let body = String::from_utf8_lossy(&bytes).into_owned();
        if status != 200 {
            let message = self.quote(completion::server_message(&body));
            if !matches!(status, 408 | 409 | 429 | 500..=599) {
                return Err(Error::Rejected {
                    judge: self.settings.name.clone(),
                    status,
                    message,
                });
            }
            return Ok(Err(Failure {
                cause: format!("status {status}: {message}"),
                retry_after,
            }));
        }
        if let Err(error) = read {
            let cause = format!("incomplete answer: {error}");
            return Ok(Err(Failure::new(self.quote(cause))));
        }
        let Some(mut reply) = completion::parse(&bytes) else {
            let cause = format!("expected a chat completion, got: {}", self.quote(body));
            return Ok(Err(Failure::new(cause)));
        };
        if let Some(key) = &self.key {
            reply.text = key.redact(reply.text);
            reply.model = reply.model.map(|model| key.redact(model));
            reply.finish_reason = reply.finish_reason.map(|reason| key.redact(reason));
        }
        Ok(Ok(reply))
    }

    /// A server's text for a message.
    fn quote(&self, text: String) -> String {
        let text = match &self.key {
            Some(key) => key.redact(text),
            None => text,
        };
        excerpt(&text)
    }
}

/// Whether the same request may succeed later.
fn may_pass(error: &ureq::Error) -> bool {
    use ureq::Error as E;
    matches!(
        error,
        E::Io(_) | E::Timeout(_) | E::Protocol(_) | E::HostNotFound | E::ConnectionFailed
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn temporary_failures_are_recognised() {
        let broken = std::io::ErrorKind::ConnectionReset.into();
        assert!(may_pass(&ureq::Error::Io(broken)));
        assert!(may_pass(&ureq::Error::Timeout(ureq::Timeout::Global)));
        assert!(!may_pass(&ureq::Error::BadUri("x".to_owned())));
    }

    #[test]
    fn settings_and_key_are_checked() {
        let mut settings = EndpointSettings::new("a", "http://localhost/v1/", "m");
        assert_eq!(
            Client::new(settings.clone()).unwrap().url,
            "http://localhost/v1/chat/completions"
        );
        settings.api_key_env = Some("WM_JUDGE_NO_SUCH_VARIABLE".to_owned());
        assert!(matches!(
            Client::new(settings.clone()),
            Err(Error::ApiKey { .. })
        ));
        settings.retries = 1000;
        assert!(matches!(Client::new(settings), Err(Error::Setting { .. })));
    }
}
