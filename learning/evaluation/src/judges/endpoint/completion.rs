use serde::{Deserialize, Serialize};

/// Tokens of an answer, as counted by the server.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Usage {
    /// Of the prompt and its pictures.
    #[serde(rename = "prompt_tokens", default)]
    pub input_tokens: u64,
    /// Of the answer and its reasoning.
    #[serde(rename = "completion_tokens", default)]
    pub output_tokens: u64,
}

impl Usage {
    pub(crate) fn add(&mut self, other: Self) {
        self.input_tokens = self.input_tokens.saturating_add(other.input_tokens);
        self.output_tokens = self.output_tokens.saturating_add(other.output_tokens);
    }
}

/// An answer of a server.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct Reply {
    /// Text of the model; may be empty.
    pub text: String,
    /// Reason for its end, such as `stop` or `length`.
    pub finish_reason: Option<String>,
    /// Name of the model on the server.
    pub model: Option<String>,
    /// Tokens, if the server counts them.
    pub usage: Option<Usage>,
    /// Number of requests sent.
    pub attempts: u32,
}

#[derive(Deserialize)]
struct Completion {
    choices: Vec<Choice>,
    usage: Option<Usage>,
    model: Option<String>,
}

#[derive(Deserialize)]
struct Choice {
    message: Message,
    finish_reason: Option<String>,
}

#[derive(Deserialize)]
struct Message {
    content: Option<Content>,
    refusal: Option<String>,
}

#[derive(Deserialize)]
#[serde(untagged)]
enum Content {
    Text(String),
    /// Some servers answer in the form of requests.
    Parts(Vec<Part>),
}

#[derive(Deserialize)]
struct Part {
    text: Option<String>,
}

/// Parses an answer; `None` if it is not a chat completion.
pub(super) fn parse(body: &[u8]) -> Option<Reply> {
    let completion: Completion = serde_json::from_slice(body).ok()?;
    let choice = completion.choices.into_iter().next()?;
    let text = match choice.message.content {
        Some(Content::Text(text)) => text,
        Some(Content::Parts(parts)) => parts.into_iter().filter_map(|part| part.text).collect(),
        None => choice.message.refusal.unwrap_or_default(),
    };
    Some(Reply {
        text,
        finish_reason: choice.finish_reason,
        model: completion.model,
        usage: completion.usage,
        attempts: 0,
    })
}

/// The error message in the form of OpenAI or of another server, else the body.
pub(super) fn server_message(body: &str) -> String {
    let value: serde_json::Value = serde_json::from_str(body).unwrap_or_default();
    let places = ["/error/message", "/error", "/message", "/detail"];
    let found = places
        .iter()
        .find_map(|place| value.pointer(place)?.as_str());
    found.unwrap_or(body).to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn completions_are_parsed() {
        let reply = parse(
            br#"{"id": "x", "model": "m", "choices": [{"index": 0, "finish_reason": "stop",
                "message": {"role": "assistant", "content": "Final Score: 1", "reasoning_content": null}}],
                "usage": {"prompt_tokens": 7, "completion_tokens": 3, "total_tokens": 10}}"#,
        );
        let expected = Reply {
            text: "Final Score: 1".to_owned(),
            finish_reason: Some("stop".to_owned()),
            model: Some("m".to_owned()),
            usage: Some(Usage {
                input_tokens: 7,
                output_tokens: 3,
            }),
            attempts: 0,
        };
        assert_eq!(reply, Some(expected));
        let text = |message: &str| {
            let reply = parse(format!(r#"{{"choices": [{{"message": {message}}}]}}"#).as_bytes());
            reply.map(|reply| reply.text)
        };
        assert_eq!(text(r#"{"content": null}"#).unwrap(), "");
        assert_eq!(text(r#"{"content": null, "refusal": "no"}"#).unwrap(), "no");
        assert_eq!(
            text(r#"{"content": [{"type": "text", "text": "a"}, {"text": "b"}]}"#).unwrap(),
            "ab"
        );
        assert_eq!(text(r#"{"content": 1}"#), None);
        for garbage in [
            "",
            "<html>",
            "{}",
            r#"{"choices": []}"#,
            r#"{"error": {"message": "no"}}"#,
        ] {
            assert_eq!(parse(garbage.as_bytes()), None);
        }
    }

    #[test]
    fn error_messages_are_extracted() {
        for body in [
            r#"{"error": {"message": "too long", "code": 400}}"#,
            r#"{"error": "too long"}"#,
            r#"{"object": "error", "message": "too long"}"#,
            r#"{"detail": "too long"}"#,
            "too long",
        ] {
            assert_eq!(server_message(body), "too long");
        }
        assert_eq!(server_message(r#"{"detail": [1]}"#), r#"{"detail": [1]}"#);
    }

    proptest::proptest! {
        #[test]
        fn no_body_panics(body in "(?s).{0,200}") {
            parse(body.as_bytes());
            server_message(&body);
        }
    }
}
