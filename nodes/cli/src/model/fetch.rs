//! `wm model fetch`.

mod catalogue;
#[cfg(feature = "fetch")]
mod download;

use crate::output::print;
use anyhow::{Context as _, Result, bail};
use catalogue::{MODELS, Model};
use clap::Args;
use std::path::{Path, PathBuf};

/// Downloads a published model from where its authors put it, with a configuration beside it.
///
/// An interrupted download goes on where it was, if the server still has the same file. What Hugging Face states a SHA-256 of is checked against it.
#[derive(Args, Debug)]
#[command(after_help = catalogue::names())]
pub struct FetchCommand {
    /// The model
    #[arg(value_name = "NAME")]
    name: String,
    /// Folder for its files [default: models/NAME]
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Revision of a Hugging Face repository: a branch, a tag or a commit
    #[arg(long, default_value = "main")]
    revision: String,
    /// File with a Hugging Face access token, for models whose licence has to be accepted first
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

impl FetchCommand {
    /// Runs it.
    pub fn run(self) -> Result<()> {
        let Some(model) = MODELS.iter().find(|model| model.name == self.name) else {
            bail!("no model `{}` is known; {}", self.name, catalogue::names());
        };
        let folder = match &self.output {
            Some(folder) => folder.clone(),
            None => Path::new("models").join(model.name),
        };
        let files: Vec<(String, PathBuf)> = model
            .files
            .iter()
            .map(|file| {
                let name = file.rsplit('/').next().unwrap_or(file);
                (model.url(file, &self.revision), folder.join(name))
            })
            .collect();
        self.download(model, &files)?;
        if let Some(config) = model.config()? {
            let path = folder.join("config.json");
            std::fs::write(&path, config).with_context(|| path.display().to_string())?;
            print(format_args!("{}\n", path.display()))?;
        }
        Ok(())
    }

    #[cfg(feature = "fetch")]
    fn download(&self, model: &Model, files: &[(String, PathBuf)]) -> Result<()> {
        let token = match &self.token_file {
            Some(path) => {
                let token =
                    std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
                Some(token.trim().to_owned())
            }
            None => None,
        };
        let client = download::Client::new(token);
        for (url, path) in files {
            let fetched = client.fetch(url, path).with_context(|| match model.gated {
                true => format!(
                    "{url} (its licence has to be accepted at {}, and a token given with --token-file)",
                    model.page()
                ),
                false => url.clone(),
            })?;
            print(format_args!("{}  {}\n", fetched.sha256, path.display()))?;
        }
        Ok(())
    }

    #[cfg(not(feature = "fetch"))]
    fn download(&self, _model: &Model, files: &[(String, PathBuf)]) -> Result<()> {
        let mut by_hand = String::new();
        for (url, path) in files {
            by_hand.push_str(&format!("\n  {url}\n    -> {}", path.display()));
        }
        // Read only with the feature.
        let _ = &self.token_file;
        bail!(
            "this wm was built without downloads: build it with `cargo build --release --features fetch`, \
             or download by hand:{by_hand}"
        );
    }
}
