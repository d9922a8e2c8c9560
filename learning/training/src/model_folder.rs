//! The folder of a model whose parts are trained in sequence.

use std::path::Path;

use anyhow::{Context as _, Result, bail};
use serde_json::{Value, json};
use wm_model::{
    Autoencoder, LatentSpace,
    trained_folder::{EMBEDDED, TrainedFolder},
    weights::Precision,
};
use wm_zoo::{ModelFolder, folder};

const AUTOENCODER: &str = "autoencoder.safetensors";

/// Makes `out` a model that encodes as the model `encoder` does, so that what is trained on its latents can be used from
/// there, unless it is one already: what encodes is copied, or, as it may be large, named by a `model.json` where `encoder`
/// has one.
///
/// # Errors
/// If `out` holds another encoder, or a file cannot be read or written.
pub fn carry_encoder(encoder: &str, out: &Path) -> Result<()> {
    let source = ModelFolder::open(encoder)?;
    let trained = match &source {
        ModelFolder::Trained(trained) => trained,
        ModelFolder::Described(_) if is_same(Path::new(encoder), out) => return Ok(()),
        ModelFolder::Described(_) => return describe(encoder, &source.space()?, out),
    };
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let own = trained.autoencoder()?;
    let there = out.join(AUTOENCODER);
    if there.is_file() || is_taef2(out) {
        let found = Autoencoder::open(out)?;
        if found.space() != own.space() {
            bail!(
                "{} holds the latent space {}, expected {} of --encoder {encoder}; use another --out",
                out.display(),
                found.space(),
                own.space()
            );
        }
        return Ok(());
    }
    let TrainedFolder::Folder(folder) = trained else {
        debug_assert_eq!(encoder, EMBEDDED);
        return Ok(own.save(&there, Precision::F16)?);
    };
    let names: &[&str] = if is_taef2(folder) {
        &TAEF2
    } else {
        &[AUTOENCODER]
    };
    for name in names {
        // A file may be given in place of its folder.
        let from = if folder.is_dir() {
            folder.join(name)
        } else {
            folder.clone()
        };
        let copied = std::fs::copy(&from, out.join(name));
        copied.with_context(|| format!("copying {}", from.display()))?;
    }
    Ok(())
}

/// Writes the `model.json` of `encoder`, a folder with latents of `space`, into `out`: without the transition model, and
/// with its files where they are.
fn describe(encoder: &str, space: &LatentSpace, out: &Path) -> Result<()> {
    let path = out.join(folder::FILE);
    if path.is_file() {
        let found = ModelFolder::open(&out.display().to_string())?.space()?;
        if found != *space {
            bail!(
                "{} holds the latent space {found}, expected {space} of --encoder {encoder}; use another --out",
                out.display()
            );
        }
        return Ok(());
    }
    let mut description = description_of(Path::new(encoder))?;
    if let Some(parts) = description.as_object_mut() {
        parts.remove("transition");
    }
    write_description(out, &description)
}

/// The `model.json` of a folder, with absolute paths.
///
/// # Errors
/// If it cannot be read.
pub fn description_of(folder: &Path) -> Result<Value> {
    let path = folder.join(folder::FILE);
    let text = std::fs::read_to_string(&path).with_context(|| path.display().to_string())?;
    let mut description =
        serde_json::from_str(&text).with_context(|| path.display().to_string())?;
    let folder = std::path::absolute(folder).with_context(|| folder.display().to_string())?;
    place(&mut description, &folder);
    Ok(description)
}

/// Keys of a description whose strings are names of files.
const FILES: [&str; 4] = ["weights", "config", "tokenizer", "normalisation"];

fn place(part: &mut Value, folder: &Path) {
    for (key, value) in part.as_object_mut().into_iter().flatten() {
        match value {
            Value::String(file) if FILES.contains(&key.as_str()) => {
                *value = json!(folder.join(file));
            }
            other => place(other, folder),
        }
    }
}

/// Writes the `model.json` of a folder.
///
/// # Errors
/// If it cannot be written.
pub fn write_description(folder: &Path, description: &Value) -> Result<()> {
    let path = folder.join(folder::FILE);
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(&path, format!("{description:#}\n")))
        .with_context(|| path.display().to_string())
}

const TAEF2: [&str; 2] = ["taef2_encoder.safetensors", "taef2_decoder.safetensors"];

fn is_taef2(folder: &Path) -> bool {
    TAEF2.iter().all(|name| folder.join(name).is_file())
}

fn is_same(a: &Path, b: &Path) -> bool {
    let whole = |path: &Path| path.canonicalize().ok();
    whole(a).is_some_and(|a| whole(b) == Some(a))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_encoder_is_copied_once_and_another_one_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("mine");
        carry_encoder(EMBEDDED, &out).unwrap();
        let tiny = TrainedFolder::Embedded.autoencoder().unwrap();
        assert_eq!(Autoencoder::open(&out).unwrap().space(), tiny.space());
        carry_encoder(EMBEDDED, &out).unwrap();

        let other = dir.path().join("other");
        std::fs::create_dir(&other).unwrap();
        let random = Autoencoder::random(tiny.config().clone(), 3).unwrap();
        random
            .save(other.join(AUTOENCODER), Precision::F16)
            .unwrap();
        let error = carry_encoder(other.to_str().unwrap(), &out).unwrap_err();
        assert!(error.to_string().contains("use another --out"), "{error}");
        // By its file, too.
        let copy = dir.path().join("copy");
        let file = other.join(AUTOENCODER);
        carry_encoder(file.to_str().unwrap(), &copy).unwrap();
        let read = |folder: &Path| std::fs::read(folder.join(AUTOENCODER)).unwrap();
        assert!(read(&copy) == read(&other));
    }
}
