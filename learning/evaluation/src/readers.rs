//! Models that read latents besides a transition model: inverse dynamics models and success probes, of the model's
//! folder and further ones.

use std::{
    collections::{BTreeMap, BTreeSet},
    path::{Path, PathBuf},
    sync::Arc,
};

use anyhow::{Context as _, Result, ensure};
use candle_core::Tensor;
use clap::Args;
use wm_model::{
    LatentSpace, Weights,
    trained_folder::{IDM_FILE, PROBE_FILE},
    transition::LATENT_SPACE_KEY,
};
use wm_zoo::{
    ModelFolder,
    folder::NativeDecoder,
    idm::{IDM_KEY, TrainedIdm},
    success_probe::{PROBE_KEY, SuccessClassifier},
};

use crate::policy::JudgeInputs;

/// Prefix of the figures of the model's own success probe.
pub(crate) const OWN_PROBE: &str = "success";

/// Further models that read latents. With several world models, each gets those for its latents.
#[derive(Args, Clone, Debug, Default)]
pub struct ReaderArgs {
    /// Further inverse dynamics models, for example for another number of steps. One trained on the features of a
    /// model's encoder reads the model's latents through its adapter's decoder
    #[arg(long, num_args = 1.., value_name = "FILE")]
    pub idm: Vec<PathBuf>,
    /// Further success probes, such as linear and temporal ones, by the same rule
    #[arg(long, num_args = 1.., value_name = "FILE")]
    pub probe: Vec<PathBuf>,
}

impl ReaderArgs {
    /// Checks early that each file reads the latents of one of the models.
    ///
    /// # Errors
    /// Names the first that reads none, and its latents.
    pub fn require_models(&self, models: &[ModelFolder]) -> Result<()> {
        let idms = self.idm.iter().map(|path| (path, IDM_KEY));
        let probes = self.probe.iter().map(|path| (path, PROBE_KEY));
        for (path, key) in idms.chain(probes) {
            let reads = space_of(&open(path, key)?)?;
            let mut spaces = Vec::new();
            for model in models {
                spaces.push(model.space()?);
                spaces.extend(model.native_decoder()?.map(|d| d.native().clone()));
            }
            let names: Vec<String> = spaces.iter().map(ToString::to_string).collect();
            ensure!(
                spaces.iter().any(|space| same(space, &reads)),
                "{}: reads latents of {reads}; expected {} (train one with wm train idm|probe --encoder MODEL)",
                path.display(),
                names.join(", or ")
            );
        }
        Ok(())
    }
}

/// A model that reads latents, directly or through the decoder of their adapter.
#[derive(Debug)]
pub struct Reader<M> {
    /// Prefix of its figures, such as `idm_k1`.
    pub name: String,
    /// The model.
    pub model: M,
    /// Name of its latent space.
    pub space: String,
    through: Option<Arc<NativeDecoder>>,
}

impl<M> Reader<M> {
    /// Converts latents (N, h, w, C) of the world model for this one.
    ///
    /// # Errors
    /// If they do not fit the adapter.
    pub fn latents(&self, latents: &Tensor) -> Result<Tensor> {
        match &self.through {
            None => Ok(latents.clone()),
            Some(adapter) => Ok(adapter.decode(latents)?),
        }
    }
}

/// All readers of one world model's latents.
#[derive(Debug, Default)]
pub struct Readers {
    /// Inverse dynamics models, the folder's own first.
    pub idms: Vec<Reader<TrainedIdm>>,
    /// Success probes, the folder's own first.
    pub probes: Vec<Reader<SuccessClassifier>>,
    /// Lower-case hex SHA-256 of the tensors of each trained reader, by name.
    pub hashes: BTreeMap<String, String>,
}

impl Readers {
    /// Readers of the model's folder, and those of `more`.
    ///
    /// # Errors
    /// Names a missing or invalid tensor or file.
    pub fn open(folder: &ModelFolder, more: &ReaderArgs) -> Result<Self> {
        let mut readers = Self::of_folder(folder)?;
        readers.add(more, folder)?;
        Ok(readers)
    }

    /// Readers of the model's folder.
    ///
    /// # Errors
    /// Names a missing or invalid tensor or file.
    pub fn of_folder(folder: &ModelFolder) -> Result<Self> {
        let mut readers = Self::default();
        let space = folder.space()?.name;
        if let Some(model) = folder.idm()? {
            let name = format!("idm_k{}", model.idm().horizon());
            readers.hash(&name, folder.weights(IDM_FILE)?);
            readers.idms.push(Reader {
                name,
                model,
                space: space.clone(),
                through: None,
            });
        }
        if let Some(model) = folder.probe()? {
            let name = OWN_PROBE.to_owned();
            readers.hash(&name, folder.weights(PROBE_FILE)?);
            readers.probes.push(Reader {
                name,
                model,
                space,
                through: None,
            });
        }
        Ok(readers)
    }

    /// Adds those of `more` that read latents of `folder`, or of its encoder.
    ///
    /// # Errors
    /// If a file cannot be read.
    pub fn add(&mut self, more: &ReaderArgs, folder: &ModelFolder) -> Result<()> {
        if more.idm.is_empty() && more.probe.is_empty() {
            return Ok(());
        }
        let own = folder.space()?;
        let native = folder.native_decoder()?.map(Arc::new);
        // The latents that it reads, if either.
        let fit = |reads: &LatentSpace| match &native {
            _ if same(&own, reads) => Some(None),
            Some(native) if same(native.native(), reads) => Some(Some(Arc::clone(native))),
            _ => None,
        };
        for path in &more.idm {
            let weights = open(path, IDM_KEY)?;
            let reads = space_of(&weights)?;
            let Some(through) = fit(&reads) else { continue };
            let hash = weights.sha256();
            let model =
                TrainedIdm::from_weights(weights).with_context(|| path.display().to_string())?;
            let of = if through.is_some() { "_native" } else { "" };
            let k = model.idm().horizon();
            let name = self.free_name(|n| format!("idm{n}{of}_k{k}"));
            self.hashes.insert(name.clone(), hash);
            self.idms.push(Reader {
                name,
                model,
                space: reads.name,
                through,
            });
        }
        for path in &more.probe {
            let weights = open(path, PROBE_KEY)?;
            let reads = space_of(&weights)?;
            let Some(through) = fit(&reads) else { continue };
            let hash = weights.sha256();
            let model = SuccessClassifier::of_trained(weights, &reads)
                .with_context(|| path.display().to_string())?;
            let of = if through.is_some() { "_native" } else { "" };
            let name = self.free_name(|n| format!("success{n}{of}_{}", model.kind()));
            self.hashes.insert(name.clone(), hash);
            self.probes.push(Reader {
                name,
                model,
                space: reads.name,
                through,
            });
        }
        Ok(())
    }

    /// The success probes as judges.
    pub(crate) fn judges(&self) -> Vec<JudgeInputs> {
        let probes = self.probes.iter();
        let judges = probes.map(|probe| JudgeInputs::probe(&probe.name, probe.model.kind()));
        judges.collect()
    }

    fn hash(&mut self, name: &str, weights: Option<Weights>) {
        if let Some(weights) = weights {
            self.hashes.insert(name.to_owned(), weights.sha256());
        }
    }

    /// The first unused of `name("")`, `name("2")`, `name("3")`, ...
    fn free_name(&self, name: impl Fn(&str) -> String) -> String {
        let idms = self.idms.iter().map(|reader| &*reader.name);
        let taken: BTreeSet<&str> = idms.chain(self.probes.iter().map(|r| &*r.name)).collect();
        let mut number = 1;
        loop {
            let of = match number {
                1 => name(""),
                number => name(&number.to_string()),
            };
            if !taken.contains(&*of) {
                return of;
            }
            number += 1;
        }
    }
}

/// Opens a reader file: an inverse dynamics model ([`IDM_KEY`]) or a success probe ([`PROBE_KEY`]).
fn open(path: &Path, key: &str) -> Result<Weights> {
    let (what, file) = match key {
        IDM_KEY => ("inverse dynamics model", IDM_FILE),
        _ => ("success probe", PROBE_FILE),
    };
    let path = match path.is_dir() {
        true => path.join(file),
        false => path.to_owned(),
    };
    let weights = Weights::open(&path)?;
    ensure!(
        weights.metadata(key).is_some(),
        "{}: not an {what}",
        path.display()
    );
    Ok(weights)
}

fn space_of(weights: &Weights) -> Result<LatentSpace> {
    Ok(weights.json(LATENT_SPACE_KEY)?)
}

/// Whether both latent spaces are equal, whatever their names.
fn same(a: &LatentSpace, b: &LatentSpace) -> bool {
    (&a.hash, a.shape()) == (&b.hash, b.shape())
}
