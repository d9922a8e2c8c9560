//! The folder of a model whose parts are trained in sequence.

use std::path::Path;

use anyhow::{Context as _, Result, bail};
use serde_json::{Value, json};
use wm_model::{
    Autoencoder,
    trained_folder::{AutoencoderFiles, TrainedFolder},
    weights::Precision,
};
use wm_zoo::{ModelFolder, folder};

/// Makes `out` a model that encodes as the model `encoder` does, so that what is trained on its latents can be used from
/// there, unless it is one already. An autoencoder is copied; published networks may be large: the `model.json`
/// names their files.
///
/// # Errors
/// If `out` holds another encoder, or a file cannot be read or written.
pub fn carry_encoder(encoder: &str, out: &Path) -> Result<()> {
    let source = ModelFolder::open(encoder)?;
    let trained = source.trained();
    if trained.is_none() && is_same(Path::new(encoder), out) {
        return Ok(());
    }
    let space = source.space()?;
    if has_encoder(out) {
        let found = ModelFolder::open(&out.display().to_string())?.space()?;
        if found != space {
            bail!(
                "{} holds the latent space {found}, expected {space} of --encoder {encoder}; use another --out",
                out.display()
            );
        }
    } else if let Some(trained) = trained {
        copy_autoencoder(trained, out)?;
        folder::describe_autoencoder(out)?;
        if let TrainedFolder::Folder {
            autoencoder: AutoencoderFiles::Taef2 { size, .. },
            ..
        } = trained
        {
            // its weights do not say for which size of pictures it is used
            let mut description = read_description(&out.join(folder::FILE))?;
            if let Some(parts) = description.as_object_mut() {
                parts.insert("image".to_owned(), json!([size.0, size.1]));
            }
            write_description(out, &description)?;
        }
    } else {
        let mut description = description_of(Path::new(encoder))?;
        if let Some(parts) = description.as_object_mut() {
            parts.remove("transition");
        }
        write_description(out, &description)?;
    }
    if trained.is_some() {
        folder::describe_autoencoder(out)?;
    }
    Ok(())
}

/// Copies the autoencoder of `trained` into `out`, under the usual names of its files.
fn copy_autoencoder(trained: &TrainedFolder, out: &Path) -> Result<()> {
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    let whole = out.join(Autoencoder::FILE);
    let TrainedFolder::Folder { autoencoder, .. } = trained else {
        return Ok(trained.autoencoder()?.save(whole, Precision::F16)?);
    };
    let halves = Autoencoder::TAEF2_FILES;
    let files = match autoencoder {
        AutoencoderFiles::Whole(path) if is_taef2(path) => halves
            .map(|name| (path.join(name), out.join(name)))
            .to_vec(),
        AutoencoderFiles::Whole(path) if path.is_dir() => {
            vec![(path.join(Autoencoder::FILE), whole)]
        }
        // A file may be given in place of its folder.
        AutoencoderFiles::Whole(path) => vec![(path.clone(), whole)],
        AutoencoderFiles::Taef2 { halves: from, .. } => {
            let to = halves.map(|name| out.join(name));
            from.iter().cloned().zip(to).collect()
        }
    };
    for (from, to) in files {
        std::fs::copy(&from, to).with_context(|| format!("copying {}", from.display()))?;
    }
    Ok(())
}

/// The `model.json` of a folder, with absolute paths.
///
/// # Errors
/// If it cannot be read.
pub fn description_of(folder: &Path) -> Result<Value> {
    let mut description = read_description(&folder.join(folder::FILE))?;
    let folder = std::path::absolute(folder).with_context(|| folder.display().to_string())?;
    place(&mut description, &folder);
    Ok(description)
}

fn read_description(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    serde_json::from_str(&text).with_context(|| path.display().to_string())
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

/// Whether the model in `out` has an encoder already.
fn has_encoder(out: &Path) -> bool {
    let has = |name| out.join(name).is_file();
    has(folder::FILE) || has(Autoencoder::FILE) || is_taef2(out)
}

fn is_taef2(folder: &Path) -> bool {
    let has = |name| folder.join(name).is_file();
    !has(Autoencoder::FILE) && Autoencoder::TAEF2_FILES.into_iter().all(has)
}

fn is_same(a: &Path, b: &Path) -> bool {
    let whole = |path: &Path| path.canonicalize().ok();
    whole(a).is_some_and(|a| whole(b) == Some(a))
}

#[cfg(test)]
mod tests {
    use wm_model::{AutoencoderConfig, trained_folder::EMBEDDED};

    use super::*;

    #[test]
    fn the_encoder_is_copied_once_and_another_one_is_refused() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path().join("mine");
        carry_encoder(EMBEDDED, &out).unwrap();
        let tiny = TrainedFolder::Embedded.autoencoder().unwrap();
        assert_eq!(Autoencoder::open(&out).unwrap().space(), tiny.space());
        assert!(out.join(folder::FILE).is_file());
        carry_encoder(EMBEDDED, &out).unwrap();

        let other = dir.path().join("other");
        std::fs::create_dir(&other).unwrap();
        let random = Autoencoder::random(tiny.config().clone(), 3).unwrap();
        random
            .save(other.join(Autoencoder::FILE), Precision::F16)
            .unwrap();
        let error = carry_encoder(other.to_str().unwrap(), &out).unwrap_err();
        assert!(error.to_string().contains("use another --out"), "{error}");
        // By its file, too.
        let copy = dir.path().join("copy");
        let file = other.join(Autoencoder::FILE);
        carry_encoder(file.to_str().unwrap(), &copy).unwrap();
        let read = |folder: &Path| std::fs::read(folder.join(Autoencoder::FILE)).unwrap();
        assert!(read(&copy) == read(&other));
        let space = |name: &Path| ModelFolder::open(name.to_str().unwrap()).unwrap().space();
        assert_eq!(space(&copy).unwrap(), space(&other).unwrap());
    }
    #[test]
    fn taef2_keeps_its_size_of_pictures() {
        let dir = tempfile::tempdir().unwrap();
        let (source, out) = (dir.path().join("taef2"), dir.path().join("mine"));
        std::fs::create_dir(&source).unwrap();
        let random = Autoencoder::random(AutoencoderConfig::taef2(64, 64), 1).unwrap();
        let whole = dir.path().join("whole.safetensors");
        random.save(&whole, Precision::F16).unwrap();
        let tensors = candle_core::safetensors::load(&whole, &candle_core::Device::Cpu).unwrap();
        let halves = Autoencoder::TAEF2_FILES;
        for (file, half) in halves.into_iter().zip(["encoder.", "decoder."]) {
            let of_half = tensors.iter().filter_map(|(name, tensor)| {
                Some((name.strip_prefix(half)?.to_owned(), tensor.clone()))
            });
            let of_half: std::collections::HashMap<_, _> = of_half.collect();
            candle_core::safetensors::save(&of_half, source.join(file)).unwrap();
        }
        folder::describe_autoencoder(&source).unwrap();
        let mut description = read_description(&source.join(folder::FILE)).unwrap();
        description["image"] = json!([64, 64]);
        write_description(&source, &description).unwrap();
        let space = |name: &Path| ModelFolder::open(name.to_str().unwrap()).unwrap().space();
        for _ in 0..2 {
            carry_encoder(source.to_str().unwrap(), &out).unwrap();
            assert_eq!(space(&out).unwrap(), space(&source).unwrap());
        }
    }
}
