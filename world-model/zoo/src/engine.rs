//! What computes.

use std::fmt;
use std::str::FromStr;

use wm_model::Error;
use wm_model::ops::Form;

/// What computes a model's layers. Both give the same numbers, to rounding.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Engine {
    /// Plain candle operations: any device, the reference.
    Candle,
    /// The kernels of [`wm_model::ops`] on weights that are packed once, on the CPU: f32 sums, weights of f32 or bf16. A
    /// layer that has no such kernel takes candle's operations.
    #[default]
    Cpu,
}

impl Engine {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Candle => "candle",
            Self::Cpu => "cpu",
        }
    }
}

impl Engine {
    /// How it computes the operations of [`wm_model::ops`] that have two forms.
    pub(crate) fn form(self) -> Form {
        match self {
            Self::Candle => Form::Plain,
            Self::Cpu => Form::Kernel,
        }
    }
}

impl fmt::Display for Engine {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Engine {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self, Error> {
        [Self::Candle, Self::Cpu]
            .into_iter()
            .find(|engine| engine.name() == name)
            .ok_or_else(|| Error::config("engine", format!("`{name}`, expected candle or cpu")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        for engine in [Engine::Candle, Engine::Cpu] {
            assert_eq!(engine.to_string().parse::<Engine>().unwrap(), engine);
        }
        let message = "gpu".parse::<Engine>().unwrap_err().to_string();
        assert!(message.contains("`gpu`"), "{message}");
    }
}
