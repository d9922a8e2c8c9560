mod check;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{PictureSettings, Usage};

/// A judge: a model and its server. `judges.yaml` of this crate explains every key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EndpointSettings {
    /// Name in tables, records and messages.
    pub name: String,
    /// Base address, without `/chat/completions`.
    pub base_url: String,
    /// Name of the model on the server.
    pub model: String,
    /// Environment variable with the API key, never the key itself.
    #[serde(default)]
    pub api_key_env: Option<String>,
    /// Not sent if `None`.
    #[serde(default = "temperature")]
    pub temperature: Option<f64>,
    /// Most tokens of an answer; not sent if `None`.
    #[serde(default = "max_tokens")]
    pub max_tokens: Option<u32>,
    /// Not sent if `None`; a repeated question is then unchanged.
    #[serde(default = "seed")]
    pub seed: Option<u64>,
    /// Repetitions of a question whose answer has no score.
    #[serde(default = "reasks")]
    pub reasks: u32,
    /// Temperature of a repeated question; that of the first by default.
    #[serde(default)]
    pub reask_temperature: Option<f64>,
    /// Time limit of a request with its answer \[s\].
    #[serde(default = "timeout_s")]
    pub timeout_s: u64,
    /// Retries of a request after a temporary failure.
    #[serde(default = "retries")]
    pub retries: u32,
    /// Most requests per minute.
    #[serde(default)]
    pub requests_per_minute: Option<u32>,
    /// Most input and output tokens per minute.
    #[serde(default)]
    pub tokens_per_minute: Option<u64>,
    /// Price of tokens.
    #[serde(default)]
    pub price_per_million: Price,
    /// Most cost of all answers in the record.
    #[serde(default)]
    pub max_cost: Option<f64>,
    /// Encoding of frames.
    #[serde(default)]
    pub picture: PictureSettings,
    /// Position of the prompt.
    #[serde(default)]
    pub text: TextPlace,
    /// Further fields of the request.
    #[serde(default)]
    pub body: Map<String, Value>,
}

/// Price of a million tokens, in any currency.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Price {
    /// Of the prompt and its pictures.
    pub input: f64,
    /// Of the answer and its reasoning.
    pub output: f64,
}

impl Price {
    /// Cost of tokens.
    #[must_use]
    pub fn of(self, usage: Usage) -> f64 {
        // Exact below 2^53 tokens.
        let (input, output) = (usage.input_tokens as f64, usage.output_tokens as f64);
        (input * self.input + output * self.output) / 1e6
    }
}

/// Position of the prompt.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TextPlace {
    /// Before the pictures.
    First,
    /// After the pictures.
    #[default]
    Last,
}

fn temperature() -> Option<f64> {
    Some(0.0)
}

fn max_tokens() -> Option<u32> {
    Some(1024)
}

fn seed() -> Option<u64> {
    Some(0)
}

fn reasks() -> u32 {
    2
}

fn timeout_s() -> u64 {
    120
}

fn retries() -> u32 {
    5
}

impl EndpointSettings {
    /// A judge with default settings.
    #[must_use]
    pub fn new(name: &str, base_url: &str, model: &str) -> Self {
        Self {
            name: name.to_owned(),
            base_url: base_url.to_owned(),
            model: model.to_owned(),
            api_key_env: None,
            temperature: temperature(),
            max_tokens: max_tokens(),
            seed: seed(),
            reasks: reasks(),
            reask_temperature: None,
            timeout_s: timeout_s(),
            retries: retries(),
            requests_per_minute: None,
            tokens_per_minute: None,
            price_per_million: Price::default(),
            max_cost: None,
            picture: PictureSettings::default(),
            text: TextPlace::default(),
            body: Map::new(),
        }
    }
}

#[cfg(test)]
mod tests;
