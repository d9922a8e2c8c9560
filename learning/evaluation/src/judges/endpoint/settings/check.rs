use super::{EndpointSettings, Price};
use crate::judges::{Error, Result};

/// Request fields with their own settings, or with an effect on the form of the answer.
const RESERVED: [&str; 7] = [
    "model",
    "messages",
    "stream",
    "n",
    "temperature",
    "max_tokens",
    "seed",
];

impl EndpointSettings {
    /// Checks all values.
    ///
    /// # Errors
    /// Names the first invalid setting, its value and the accepted values.
    pub fn check(&self) -> Result<()> {
        let amount = |x: f64| x.is_finite() && x >= 0.0;
        let amounts = |x: Option<f64>| x.is_none_or(amount);
        let Price { input, output } = self.price_per_million;
        let free = input == 0.0 && output == 0.0;
        let reserved = RESERVED
            .iter()
            .find(|field| self.body.contains_key(**field));
        let checks = [
            (
                "name",
                format!("{:?}", self.name),
                "a name",
                !self.name.trim().is_empty(),
            ),
            (
                "model",
                format!("{:?}", self.model),
                "a name",
                !self.model.trim().is_empty(),
            ),
            (
                "base_url",
                // A URL may contain a password.
                "malformed".to_owned(),
                "http://HOST or https://HOST with a path, without user, query or spaces",
                is_base_url(&self.base_url),
            ),
            (
                "api_key_env",
                "malformed".to_owned(),
                "the name of an environment variable: capital letters, digits and _",
                self.api_key_env.as_deref().is_none_or(is_variable),
            ),
            (
                "temperature",
                shown(self.temperature),
                "0 or more",
                amounts(self.temperature),
            ),
            (
                "reask_temperature",
                shown(self.reask_temperature),
                "0 or more",
                amounts(self.reask_temperature),
            ),
            (
                "max_tokens",
                "0".to_owned(),
                "1 or more",
                self.max_tokens != Some(0),
            ),
            (
                "timeout_s",
                self.timeout_s.to_string(),
                "1 to 86400",
                (1..=86400).contains(&self.timeout_s),
            ),
            (
                "retries",
                self.retries.to_string(),
                "0 to 100",
                self.retries <= 100,
            ),
            (
                "reasks",
                self.reasks.to_string(),
                "0 to 10",
                self.reasks <= 10,
            ),
            (
                "requests_per_minute",
                "0".to_owned(),
                "1 or more",
                self.requests_per_minute != Some(0),
            ),
            (
                "tokens_per_minute",
                "0".to_owned(),
                "1 or more",
                self.tokens_per_minute != Some(0),
            ),
            (
                "price_per_million",
                format!("{input} and {output}"),
                "0 or more",
                amount(input) && amount(output),
            ),
            (
                "max_cost",
                shown(self.max_cost),
                "0 or more",
                amounts(self.max_cost),
            ),
            (
                "max_cost",
                "there without a price".to_owned(),
                "price_per_million too",
                self.max_cost.is_none() || !free,
            ),
            (
                "picture.quality",
                self.picture.quality.to_string(),
                "1 to 100",
                (1..=100).contains(&self.picture.quality),
            ),
            (
                "picture.max_side",
                "0".to_owned(),
                "1 or more",
                self.picture.max_side != Some(0),
            ),
            (
                "body",
                format!("with {}", reserved.unwrap_or(&"")),
                "fields without a setting of their own",
                reserved.is_none(),
            ),
        ];
        for (setting, found, expected, good) in checks {
            if !good {
                return Err(Error::Setting {
                    owner: format!("judge {}", self.name),
                    setting,
                    found,
                    expected,
                });
            }
        }
        if self.base_url.starts_with("https://") && !cfg!(feature = "https") {
            return Err(Error::NeedsHttps {
                judge: self.name.clone(),
                base_url: self.base_url.clone(),
            });
        }
        Ok(())
    }
}

fn is_base_url(url: &str) -> bool {
    let rest = url
        .strip_prefix("http://")
        .or_else(|| url.strip_prefix("https://"));
    rest.is_some_and(|rest| {
        let host = rest.split('/').next().unwrap_or_default();
        !host.is_empty()
            && rest
                .chars()
                .all(|c| c.is_ascii_graphic() && !"@?#\\".contains(c))
    })
}

/// Upper-case letters only: a key given by mistake has others, and is not quoted.
fn is_variable(name: &str) -> bool {
    !name.is_empty()
        && name
            .chars()
            .all(|c| c.is_ascii_uppercase() || c.is_ascii_digit() || c == '_')
}

fn shown(value: Option<f64>) -> String {
    value.map_or_else(|| "none".to_owned(), |value| value.to_string())
}
