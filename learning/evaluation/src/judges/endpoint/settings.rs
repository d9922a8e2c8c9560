mod check;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{PictureSettings, Usage};

/// A judge: a model, where it is, and how it is asked. `judges.yaml` of this crate explains every key.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EndpointSettings {
    /// What the judge is called in tables, records and messages.
    pub name: String,
    /// Where it is, without `/chat/completions`.
    pub base_url: String,
    /// What the server calls the model.
    pub model: String,
    /// The environment variable that holds the API key. Never the key.
    #[serde(default)]
    pub api_key_env: Option<String>,
    /// Not sent where there is none.
    #[serde(default = "temperature")]
    pub temperature: Option<f64>,
    /// Of an answer. Not sent where there is none.
    #[serde(default = "max_tokens")]
    pub max_tokens: Option<u32>,
    /// Not sent where there is none; then a question that is asked again is the same.
    #[serde(default = "seed")]
    pub seed: Option<u64>,
    /// How often a question is asked again whose answer has no score.
    #[serde(default = "reasks")]
    pub reasks: u32,
    /// The temperature of a question that is asked again; else that of the first.
    #[serde(default)]
    pub reask_temperature: Option<f64>,
    /// Seconds that a request may take, its answer included.
    #[serde(default = "timeout_s")]
    pub timeout_s: u64,
    /// How often a request is sent again that failed for a reason that may pass.
    #[serde(default = "retries")]
    pub retries: u32,
    /// Requests in any minute.
    #[serde(default)]
    pub requests_per_minute: Option<u32>,
    /// Tokens in any minute, of input and output.
    #[serde(default)]
    pub tokens_per_minute: Option<u64>,
    /// What tokens cost.
    #[serde(default)]
    pub price_per_million: Price,
    /// What all answers in the record may cost.
    #[serde(default)]
    pub max_cost: Option<f64>,
    /// How frames are sent.
    #[serde(default)]
    pub picture: PictureSettings,
    /// Where the prompt stands.
    #[serde(default)]
    pub text: TextPlace,
    /// More fields of the request.
    #[serde(default)]
    pub body: Map<String, Value>,
}

/// The price of a million tokens, in any currency.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Price {
    /// Of the prompt and its pictures.
    pub input: f64,
    /// Of the answer and the thoughts before it.
    pub output: f64,
}

impl Price {
    /// What so many tokens cost.
    #[must_use]
    pub fn of(self, usage: Usage) -> f64 {
        // Exact below 2^53 tokens.
        let (input, output) = (usage.input_tokens as f64, usage.output_tokens as f64);
        (input * self.input + output * self.output) / 1e6
    }
}

/// Where the prompt stands among the pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TextPlace {
    /// Before them.
    First,
    /// After them.
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
    /// A judge with the defaults.
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
