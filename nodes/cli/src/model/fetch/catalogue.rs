//! The published models and their addresses.

use wm_zoo::kinds::Kind;

/// The address of a model's files.
#[derive(Debug)]
enum Place {
    /// A repository on Hugging Face.
    HuggingFace(&'static str),
    /// A folder of a web server.
    Web {
        folder: &'static str,
        /// The page for readers.
        page: &'static str,
    },
}

/// The source of a model's configuration.
#[derive(Debug)]
enum Config {
    /// One of its files.
    Published,
    /// Our preset of this kind, since the authors publish none.
    Preset(Kind),
}

/// A published model.
#[derive(Debug)]
pub(super) struct Model {
    pub name: &'static str,
    place: Place,
    /// Paths in the repository or the folder.
    pub files: &'static [&'static str],
    config: Config,
    /// Whether a licence has to be accepted first.
    #[cfg_attr(
        not(feature = "fetch"),
        expect(dead_code, reason = "only for downloads")
    )]
    pub gated: bool,
}

/// All known models. The system's own checkpoints (DiT, S-VAE, pixel decoder) are not published yet.
pub(super) const MODELS: &[Model] = &[
    Model {
        name: "sd3-vae",
        place: Place::HuggingFace("stabilityai/stable-diffusion-3-medium-diffusers"),
        files: &["vae/config.json", "vae/diffusion_pytorch_model.safetensors"],
        config: Config::Published,
        gated: true,
    },
    Model {
        name: "va-vae",
        place: Place::HuggingFace("hustvl/vavae-imagenet256-f16d32-dinov2"),
        files: &["vavae-imagenet256-f16d32-dinov2.pt"],
        config: Config::Preset(Kind::VaVae),
        gated: false,
    },
    Model {
        name: "cosmos-ci16x16",
        place: Place::HuggingFace("nvidia/Cosmos-0.1-Tokenizer-CI16x16"),
        files: &["encoder.jit", "decoder.jit"],
        config: Config::Preset(Kind::CosmosCi16x16),
        gated: false,
    },
    Model {
        name: "vjepa2.1",
        place: Place::Web {
            folder: "https://dl.fbaipublicfiles.com/vjepa2",
            page: "https://github.com/facebookresearch/vjepa2",
        },
        files: &["vjepa2_1_vitl_dist_vitG_384.pt"],
        config: Config::Preset(Kind::Vjepa21),
        gated: false,
    },
    Model {
        name: "web-dino",
        place: Place::HuggingFace("facebook/webssl-dino300m-full2b-224"),
        files: &["config.json", "model.safetensors"],
        config: Config::Published,
        gated: false,
    },
    Model {
        name: "siglip2",
        place: Place::HuggingFace("google/siglip2-so400m-patch14-224"),
        files: &["config.json", "model.safetensors"],
        config: Config::Published,
        gated: false,
    },
];

impl Model {
    /// The address of a file, at a revision of the repository; `None`: `main`.
    pub(super) fn url(&self, file: &str, revision: Option<&str>) -> String {
        match self.place {
            Place::HuggingFace(repository) => {
                let revision = revision.unwrap_or("main");
                format!("https://huggingface.co/{repository}/resolve/{revision}/{file}")
            }
            Place::Web { folder, .. } => format!("{folder}/{file}"),
        }
    }

    /// The page with description and licence.
    #[cfg_attr(
        not(any(feature = "fetch", test)),
        expect(dead_code, reason = "only for downloads")
    )]
    pub(super) fn page(&self) -> String {
        match self.place {
            Place::HuggingFace(repository) => format!("https://huggingface.co/{repository}"),
            Place::Web { page, .. } => page.to_owned(),
        }
    }

    /// The configuration to write next to its files, if it has none of its own.
    pub(super) fn config(&self) -> Option<String> {
        match self.config {
            Config::Published => None,
            Config::Preset(kind) => Some(format!("{:#}\n", kind.published_config()?)),
        }
    }
}

/// The models' names as a sentence.
pub(super) fn names() -> String {
    let names: Vec<&str> = MODELS.iter().map(|model| model.name).collect();
    format!("Models: {}", names.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_model_has_an_address_a_page_and_a_configuration() {
        for model in MODELS {
            for file in model.files {
                assert!(model.url(file, None).starts_with("https://"), "{model:?}");
            }
            assert!(model.page().starts_with("https://"), "{model:?}");
            let published = model.files.iter().any(|file| file.ends_with("config.json"));
            assert!(published != model.config().is_some(), "{model:?}");
        }
    }
}
