//! The kinds of models.

use std::fmt;
use std::str::FromStr;
use std::sync::Arc;

use super::encoder::{EncoderConfig, EncoderParser, parser};
use crate::checkpoint::Average;
use crate::efficientnet_lite0::EfficientNetLite0Config;
use crate::vae::{CosmosConfig, SdVaeConfig, VaVaeConfig};
use crate::vit::{SiglipVisionConfig, VjepaConfig, WebDinoConfig};
use crate::{Checkpoint, Error, Result};

/// Defines [`Kind`]. A line has a kind, its name on the command line and, if it is an encoder, its
/// [`EncoderConfig`].
macro_rules! kinds {
    ($($kind:ident = $name:literal $(, encoder $config:ty)?;)*) => {
        /// A kind of model, as the command line names it; the [module](super) says what each takes and gives.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
        #[expect(missing_docs, reason = "the module has a table of them")]
        pub enum Kind {
            $($kind,)*
        }

        impl Kind {
            /// All kinds.
            pub const ALL: &'static [Self] = &[$(Self::$kind,)*];

            /// Its name on the command line.
            pub fn name(self) -> &'static str {
                match self {
                    $(Self::$kind => $name,)*
                }
            }

            fn encoder_parser(self) -> Option<EncoderParser> {
                match self {
                    $($(Self::$kind => Some(parser::<$config>),)?)*
                    _ => None,
                }
            }
        }
    };
}

kinds! {
    Dit = "dit";
    WebDino = "web-dino", encoder WebDinoConfig;
    Siglip2 = "siglip2", encoder SiglipVisionConfig;
    Siglip2Text = "siglip2-text";
    Vjepa21 = "vjepa2.1", encoder VjepaConfig;
    Sd3Vae = "sd3-vae", encoder SdVaeConfig;
    Sd3VaeDecoder = "sd3-vae-decoder";
    VaVae = "va-vae", encoder VaVaeConfig;
    VaVaeDecoder = "va-vae-decoder";
    CosmosCi16x16 = "cosmos-ci16x16", encoder CosmosConfig;
    CosmosCi16x16Decoder = "cosmos-ci16x16-decoder";
    Svae = "svae";
    Pixel = "pixel";
    Idm = "idm";
    SuccessProbe = "success-probe";
    LinearProbe = "linear-probe";
    TemporalProbe = "temporal-probe";
    ProgressProbe = "progress-probe";
    EfficientNetLite0 = "efficientnet-lite0", encoder EfficientNetLite0Config;
}

impl Kind {
    /// The tensors of this kind of model in `checkpoint`, without what its authors wrapped around them.
    pub fn weights(self, checkpoint: &Checkpoint, average: Average) -> Checkpoint {
        // Whose checkpoint holds several networks, each under its own name.
        let parts: &[&str] = match (self, average) {
            (Self::Vjepa21, Average::Ema) => &["ema_encoder", "target_encoder", "encoder"],
            (Self::Vjepa21, Average::Raw) => &["encoder"],
            (Self::Svae, _) => &["adapter"],
            (Self::Pixel, _) => &["pixel_decoder"],
            _ => &[],
        };
        checkpoint
            .weights(average)
            .first_part(parts)
            .weights(average)
    }

    /// The encoder of this kind with the configuration `config` (JSON).
    ///
    /// # Errors
    /// If the kind is no encoder, or the configuration is not valid.
    pub(crate) fn encoder(self, config: &str) -> Result<Arc<dyn EncoderConfig>> {
        if let Some(parse) = self.encoder_parser() {
            return parse(config);
        }
        let encoders = Self::ALL.iter().filter(|k| k.encoder_parser().is_some());
        let names: Vec<&str> = encoders.map(|kind| kind.name()).collect();
        let reason = format!(
            "`{self}` is no encoder, expected one of {}",
            names.join(", ")
        );
        Err(wm_model::Error::config("kind", reason).into())
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Kind {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let found = Self::ALL.iter().find(|kind| kind.name() == name);
        found.copied().ok_or_else(|| {
            let names: Vec<&str> = Self::ALL.iter().map(|kind| kind.name()).collect();
            let names = names.join(", ");
            wm_model::Error::config("kind", format!("`{name}`, expected one of {names}")).into()
        })
    }
}
