//! A network that is loaded.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use image::RgbImage;

use crate::onnx::input::{Prepared, arranged};
use crate::onnx::runtime::Session;
use crate::onnx::spec::MAX_BATCH;
use crate::onnx::{Digest, Error, Input, Layout, Output, Result, Role, Spec, Tensor};

/// No ONNX file with its weights in it is larger: protobuf ends there.
const MAX_FILE: u64 = 1 << 31;

/// A role's network, loaded, with the description it was opened by.
///
/// The typed front ends ([`Features`](crate::onnx::Features), [`Flow`](crate::onnx::Flow), ...) are what metrics use; this is what they
/// share. A run uses one thread, and the same numbers in give the same numbers out.
#[derive(Debug)]
pub struct Network {
    role: Role,
    file: PathBuf,
    digest: Digest,
    spec: Spec,
    session: Session,
}

/// An input of a network as its file declares it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// Its name in the file.
    pub name: String,
    /// Its axes: a number where the file fixes it. `None` if the file does not even fix how many there are.
    pub shape: Option<Vec<Option<usize>>>,
}

impl Network {
    /// Loads `file`, and verifies its SHA-256 if `spec` states one.
    pub(crate) fn open(role: Role, spec: Spec, file: &Path) -> Result<Self> {
        let bytes = read(role, file)?;
        let digest = Digest::of(&bytes);
        if let Some(expected) = spec.sha256.filter(|expected| *expected != digest) {
            return Err(Error::Digest {
                role,
                file: file.to_owned(),
                expected,
                found: digest,
            });
        }
        let network = Self {
            role,
            file: file.to_owned(),
            digest,
            spec,
            session: Session::open(role, file, bytes)?,
        };
        match network.fixed_batch() {
            Some(batch) if batch > MAX_BATCH => Err(Error::Unusable {
                role,
                file: file.to_owned(),
                reason: format!("a run takes {batch} inputs; expected at most {MAX_BATCH}"),
            }),
            _ => Ok(network),
        }
    }

    /// What it is for.
    pub fn role(&self) -> Role {
        self.role
    }

    /// Its file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// The SHA-256 of its file, for reports.
    pub fn digest(&self) -> Digest {
        self.digest
    }

    /// What `networks.yaml` says of it.
    pub fn spec(&self) -> &Spec {
        &self.spec
    }

    /// Its inputs, in the file's order.
    pub fn inputs(&self) -> &[Port] {
        self.session.inputs()
    }

    /// The names of its outputs, in the file's order.
    pub fn outputs(&self) -> &[String] {
        self.session.outputs()
    }

    /// Runs it once: as many inputs as it has, in the file's order; all its outputs, finite.
    pub fn run(&self, inputs: &[Tensor]) -> Result<Vec<Tensor>> {
        self.check_inputs(inputs)?;
        let outputs = self.session.run(inputs).map_err(|reason| Error::Run {
            role: self.role,
            file: self.file.clone(),
            reason,
        })?;
        for (tensor, name) in outputs.iter().zip(self.outputs()) {
            if let Some(index) = tensor.data().iter().position(|value| !value.is_finite()) {
                return Err(Error::NotFinite {
                    role: self.role,
                    file: self.file.clone(),
                    tensor: format!("output `{name}`"),
                    index,
                    value: tensor.data().get(index).copied().unwrap_or(f32::NAN),
                });
            }
        }
        Ok(outputs)
    }

    /// Inputs per run: what the file fixes, else what `networks.yaml` says.
    pub(crate) fn batch(&self) -> usize {
        self.fixed_batch().unwrap_or(self.spec.batch).max(1)
    }

    /// Inputs per run where the file fixes it.
    pub(crate) fn fixed_batch(&self) -> Option<usize> {
        *self.inputs().first()?.shape.as_ref()?.first()?
    }

    /// How it takes pictures.
    pub(crate) fn input(&self) -> &Input {
        &self.spec.input
    }

    /// How it takes pictures: their order of axes, which the check of the role has filled in.
    pub(crate) fn layout(&self) -> Layout {
        self.spec.input.layout.unwrap_or(Layout::Nchw)
    }

    /// One picture as the network sees it.
    pub(crate) fn prepare(&self, picture: &RgbImage) -> Result<Prepared> {
        self.input()
            .prepare(picture)
            .map_err(|(expected, found)| self.wrong("picture (width x height)", expected, found))
    }

    /// Pictures as one input.
    pub(crate) fn arrange(&self, pictures: &[Prepared], frames: Option<usize>) -> Result<Tensor> {
        arranged(pictures, self.layout(), frames).ok_or_else(|| {
            let expected = "pictures of one size in a run".to_owned();
            self.wrong("pictures", expected, "several sizes, or none".to_owned())
        })
    }

    /// The place of an output among those of [`Network::run`].
    pub(crate) fn index_of(&self, output: &Output, key: &str) -> Result<usize> {
        let names = self.outputs();
        let (found, asked) = match output {
            Output::Index(index) => ((*index < names.len()).then_some(*index), index.to_string()),
            Output::Name(name) => (names.iter().position(|other| other == name), name.clone()),
        };
        found.ok_or_else(|| self.misshapen(key, format!("one of {names:?}"), format!("`{asked}`")))
    }

    /// Fails unless there are `count` inputs.
    pub(crate) fn takes(&self, count: usize, what: &str) -> Result<()> {
        if self.inputs().len() == count {
            return Ok(());
        }
        let names: Vec<&str> = self
            .inputs()
            .iter()
            .map(|port| port.name.as_str())
            .collect();
        Err(self.misshapen(
            "inputs",
            format!("{count}: {what}"),
            format!("{}: {names:?}", names.len()),
        ))
    }

    pub(crate) fn misshapen(
        &self,
        tensor: impl Into<String>,
        expected: String,
        found: String,
    ) -> Error {
        Error::Shape {
            role: self.role,
            file: self.file.clone(),
            tensor: tensor.into(),
            expected,
            found,
        }
    }

    pub(crate) fn wrong(&self, what: &'static str, expected: String, found: String) -> Error {
        Error::Input {
            role: self.role,
            what,
            expected,
            found,
        }
    }

    fn check_inputs(&self, inputs: &[Tensor]) -> Result<()> {
        self.takes(inputs.len(), "what was given")?;
        for (port, tensor) in self.inputs().iter().zip(inputs) {
            let Some(shape) = &port.shape else {
                continue;
            };
            let fits = shape.len() == tensor.shape().len()
                && shape
                    .iter()
                    .zip(tensor.shape())
                    .all(|(side, found)| side.is_none_or(|side| side == *found));
            if !fits {
                let sides: Vec<String> = shape
                    .iter()
                    .map(|side| side.map_or("any".to_owned(), |side| side.to_string()))
                    .collect();
                return Err(self.misshapen(
                    format!("input `{}`", port.name),
                    format!("[{}]", sides.join(", ")),
                    format!("{:?}", tensor.shape()),
                ));
            }
        }
        Ok(())
    }
}

fn read(role: Role, file: &Path) -> Result<Vec<u8>> {
    let io = |reason| Error::Io {
        file: file.to_owned(),
        reason,
    };
    let mut bytes = Vec::new();
    File::open(file)
        .and_then(|open| open.take(MAX_FILE + 1).read_to_end(&mut bytes))
        .map_err(io)?;
    if u64::try_from(bytes.len()).is_ok_and(|len| len <= MAX_FILE) {
        return Ok(bytes);
    }
    Err(Error::Unusable {
        role,
        file: file.to_owned(),
        reason: format!("expected at most {MAX_FILE} bytes, found more"),
    })
}
