//! The configurations of the published encoders and autoencoders, of which there is one size each.

use serde_json::{Value, json};

use super::kind::Kind;
use crate::vae::{CosmosConfig, SdVaeConfig, VaVaeConfig};
use crate::vit::{SiglipTextConfig, SiglipVisionConfig, VjepaConfig, WebDinoConfig};

impl Kind {
    /// The configuration of the published checkpoint of this kind, in the form in which its config.json is read; `None`
    /// for kinds that come in several sizes.
    pub fn published_config(self) -> Option<Value> {
        Some(match self {
            Self::WebDino => json!(WebDinoConfig::vit_large()),
            // Both towers, as in the config.json on the hub.
            Self::Siglip2 | Self::Siglip2Text => json!({
                "vision_config": SiglipVisionConfig::so400m(),
                "text_config": SiglipTextConfig::so400m(),
            }),
            Self::Vjepa21 => json!(VjepaConfig::vit_large()),
            Self::Sd3Vae | Self::Sd3VaeDecoder => json!(SdVaeConfig::sd3()),
            Self::VaVae | Self::VaVaeDecoder => json!(VaVaeConfig::f16d32()),
            Self::CosmosCi16x16 | Self::CosmosCi16x16Decoder => json!(CosmosConfig::ci16x16()),
            _ => return None,
        })
    }
}

#[cfg(test)]
mod tests {
    use serde::de::DeserializeOwned;

    use super::*;
    use crate::kinds::parse;

    fn assert_read<C: DeserializeOwned + PartialEq + std::fmt::Debug>(kind: Kind, expected: &C) {
        let text = kind.published_config().unwrap().to_string();
        assert_eq!(&parse::<C>(&text).unwrap(), expected, "{kind}");
    }

    #[test]
    fn a_published_configuration_is_read_back() {
        assert_read(Kind::WebDino, &WebDinoConfig::vit_large());
        assert_read(Kind::Siglip2, &SiglipVisionConfig::so400m());
        assert_read(Kind::Siglip2Text, &SiglipTextConfig::so400m());
        assert_read(Kind::Vjepa21, &VjepaConfig::vit_large());
        assert_read(Kind::Sd3VaeDecoder, &SdVaeConfig::sd3());
        assert_read(Kind::VaVae, &VaVaeConfig::f16d32());
        assert_read(Kind::CosmosCi16x16, &CosmosConfig::ci16x16());
    }
}
