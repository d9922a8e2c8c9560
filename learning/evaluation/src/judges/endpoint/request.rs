use serde_json::{Value, json};

use super::{Detail, EndpointSettings, TextPlace};

/// Sampling settings of a question.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sampling {
    /// Not sent if `None`.
    pub temperature: Option<f64>,
    /// Not sent if `None`.
    pub seed: Option<u64>,
}

/// Body of `POST {base_url}/chat/completions`: one user message with the pictures in order, and the prompt after or
/// before them. `pictures` are URLs: data URLs for sending, hashes for the record.
#[must_use]
pub fn request<'a>(
    settings: &EndpointSettings,
    sampling: Sampling,
    prompt: &str,
    pictures: impl IntoIterator<Item = &'a str>,
) -> Value {
    let detail = settings.picture.detail;
    let pictures = pictures.into_iter().map(|url| picture(url, detail));
    let mut content: Vec<Value> = pictures.collect();
    let text = json!({"type": "text", "text": prompt});
    match settings.text {
        TextPlace::First => content.insert(0, text),
        TextPlace::Last => content.push(text),
    }
    let mut body = settings.body.clone();
    let fields = [
        ("model", Some(json!(settings.model))),
        (
            "messages",
            Some(json!([{"role": "user", "content": content}])),
        ),
        ("stream", Some(json!(false))),
        ("temperature", sampling.temperature.map(Value::from)),
        ("max_tokens", settings.max_tokens.map(Value::from)),
        ("seed", sampling.seed.map(Value::from)),
    ];
    for (name, value) in fields {
        if let Some(value) = value {
            body.insert(name.to_owned(), value);
        }
    }
    Value::Object(body)
}

fn picture(url: &str, detail: Option<Detail>) -> Value {
    match detail {
        None => json!({"type": "image_url", "image_url": {"url": url}}),
        Some(detail) => {
            json!({"type": "image_url", "image_url": {"url": url, "detail": detail}})
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SAMPLING: Sampling = Sampling {
        temperature: Some(0.0),
        seed: Some(3),
    };

    #[test]
    fn request_has_the_protocols_form() {
        let settings = EndpointSettings::new("a", "http://localhost/v1", "m");
        assert_eq!(
            request(&settings, SAMPLING, "How?", ["data:1", "data:2"]),
            json!({
                "model": "m",
                "messages": [{"role": "user", "content": [
                    {"type": "image_url", "image_url": {"url": "data:1"}},
                    {"type": "image_url", "image_url": {"url": "data:2"}},
                    {"type": "text", "text": "How?"},
                ]}],
                "stream": false,
                "temperature": 0.0,
                "max_tokens": 1024,
                "seed": 3,
            })
        );
    }

    #[test]
    fn settings_change_the_request() {
        let mut settings = EndpointSettings::new("a", "http://localhost/v1", "m");
        settings.text = TextPlace::First;
        settings.picture.detail = Some(Detail::Low);
        settings.max_tokens = None;
        settings
            .body
            .insert("max_completion_tokens".to_owned(), json!(99));
        let sampling = Sampling {
            temperature: None,
            seed: None,
        };
        assert_eq!(
            request(&settings, sampling, "How?", ["data:1"]),
            json!({
                "model": "m",
                "messages": [{"role": "user", "content": [
                    {"type": "text", "text": "How?"},
                    {"type": "image_url", "image_url": {"url": "data:1", "detail": "low"}},
                ]}],
                "stream": false,
                "max_completion_tokens": 99,
            })
        );
    }
}
