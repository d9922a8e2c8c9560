//! `wm model fetch`.

mod catalogue;
mod config_file;
#[cfg(feature = "fetch")]
mod download;
#[cfg(any(feature = "fetch", test))]
mod pins;

use crate::output::print;
#[cfg(feature = "fetch")]
use anyhow::Context as _;
use anyhow::{Result, bail};
use catalogue::{MODELS, Model};
use clap::Args;
use config_file::WriteOutcome;
use std::path::{Path, PathBuf};

/// Downloads a published model from its authors' site, and writes its configuration beside it.
///
/// `fetched.json` in the folder records the commit of the Hugging Face repository and the SHA-256 of every file. Later
/// downloads to the folder accept only that commit and these hashes. An existing file that differs is replaced only
/// with `--overwrite`. An interrupted download continues where it stopped if the server still has the same file.
#[derive(Args, Debug)]
#[command(after_help = catalogue::names())]
pub(crate) struct FetchCommand {
    /// Name of the model
    #[arg(value_name = "NAME")]
    name: String,
    /// Folder for the files [default: models/NAME]
    #[arg(short, long, value_name = "DIR")]
    output: Option<PathBuf>,
    /// Revision of a Hugging Face repository: a branch, a tag or a commit [default: that of fetched.json, else main]
    #[arg(long)]
    revision: Option<String>,
    /// Replace existing files that differ, including config.json and the hashes in fetched.json
    #[arg(long)]
    overwrite: bool,
    /// File with a Hugging Face access token, for models whose licence must be accepted first
    #[arg(long, value_name = "FILE")]
    token_file: Option<PathBuf>,
}

impl FetchCommand {
    pub(crate) fn run(self) -> Result<()> {
        let Some(model) = MODELS.iter().find(|model| model.name == self.name) else {
            bail!("unknown model `{}`; {}", self.name, catalogue::names());
        };
        let folder = match &self.output {
            Some(folder) => folder.clone(),
            None => Path::new("models").join(model.name),
        };
        self.download(model, &folder)?;
        if let Some(config) = model.config() {
            let path = folder.join("config.json");
            match config_file::write(&path, &config, self.overwrite)? {
                WriteOutcome::Yes => print(format_args!("{}\n", path.display()))?,
                WriteOutcome::Kept => print(format_args!("{}\n", kept(&path)))?,
            }
        }
        Ok(())
    }

    #[cfg(feature = "fetch")]
    fn download(&self, model: &Model, folder: &Path) -> Result<()> {
        let token = match &self.token_file {
            Some(path) => {
                let token =
                    std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
                Some(token.trim().to_owned())
            }
            None => None,
        };
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
        let mut pins = pins::Pins::read(folder)?;
        let pinned = pins.of(model.name).cloned().unwrap_or_default();
        let mut revision = self.revision.clone().or_else(|| pinned.revision.clone());
        let mut pin = pinned.clone();
        let client = download::Client::new(token);
        for file in model.files {
            let name = file_name(file);
            let path = folder.join(name);
            // an existing configuration belongs to the user
            if name.ends_with(".json") && path.exists() && !self.overwrite {
                print(format_args!("{}\n", kept(&path)))?;
                continue;
            }
            let url = model.url(file, revision.as_deref());
            let hint = || match model.gated {
                true => format!(
                    "{url} (accept its licence at {}, and give a token with --token-file)",
                    model.page()
                ),
                false => url.clone(),
            };
            let stated = client.stated(&url).with_context(hint)?;
            // a branch may move between two files: use its current commit from here on
            if let Some(commit) = &stated.commit {
                revision = Some(commit.clone());
                pin.revision = Some(commit.clone());
            }
            let request = download::Request {
                url: &model.url(file, revision.as_deref()),
                path: &path,
                stated: stated.sha256.as_deref(),
                pinned: pinned.sha256.get(name).map(String::as_str),
                overwrite: self.overwrite,
            };
            let sha256 = client.fetch(&request).with_context(hint)?;
            print(format_args!("{sha256}  {}\n", path.display()))?;
            pin.sha256.insert(name.to_owned(), sha256);
            pins.write(model.name, &pin)?;
        }
        match &pin.revision {
            Some(commit) => print(format_args!("revision {commit}\n")),
            None => Ok(()),
        }
    }

    #[cfg(not(feature = "fetch"))]
    fn download(&self, model: &Model, folder: &Path) -> Result<()> {
        let mut by_hand = String::new();
        for file in model.files {
            let (url, path) = (
                model.url(file, self.revision.as_deref()),
                folder.join(file_name(file)),
            );
            by_hand.push_str(&format!("\n  {url}\n    -> {}", path.display()));
        }
        // used only with the feature
        let _ = &self.token_file;
        bail!(
            "this wm was built without downloads: build it with `cargo build --release --features fetch`, \
             or download by hand:{by_hand}"
        );
    }
}

/// The file's name in the folder.
fn file_name(file: &str) -> &str {
    file.rsplit('/').next().unwrap_or(file)
}

fn kept(path: &Path) -> String {
    format!(
        "{} exists and was kept; --overwrite replaces it",
        path.display()
    )
}
