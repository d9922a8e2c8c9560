//! The folder of a model whose parts are trained one after the other.

use std::path::Path;

use anyhow::{Context as _, Result, bail};
use wm_model::{
    Autoencoder,
    trained_folder::{EMBEDDED, TrainedFolder},
    weights::Precision,
};
use wm_zoo::ModelFolder;

const AUTOENCODER: &str = "autoencoder.safetensors";

/// Makes `out` a model that encodes as the model `encoder` does, so that what is trained on its latents can be used from
/// there: what encodes is copied, unless it is there already.
///
/// # Errors
/// If `out` holds another encoder, a file cannot be copied, or `encoder` is a folder with a `model.json`, whose files may
/// be large: train into that folder then.
pub fn carry_encoder(encoder: &str, out: &Path) -> Result<()> {
    let source = ModelFolder::open(encoder)?;
    let trained = match &source {
        ModelFolder::Trained(trained) => trained,
        ModelFolder::Described(_) if is_same(Path::new(encoder), out) => return Ok(()),
        ModelFolder::Described(folder) => bail!(
            "--out {}: expected {}, so that what is trained lies beside its model.json",
            out.display(),
            folder.name()
        ),
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
