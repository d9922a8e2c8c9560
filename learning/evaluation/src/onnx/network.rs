//! Loaded networks.

use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use image::RgbImage;

use crate::onnx::input::{Prepared, arranged};
use crate::onnx::runtime::Session;
use crate::onnx::spec::MAX_BATCH;
use crate::onnx::{Digest, Error, Input, Layout, Output, Result, Role, Spec, Tensor};

/// Largest ONNX file: the limit of protobuf.
const MAX_FILE: u64 = 1 << 31;

/// A loaded network with its description.
///
/// Metrics use typed front ends ([`Features`](crate::onnx::Features), [`Flow`](crate::onnx::Flow), ...), which share
/// this type. A run uses one thread, and is deterministic.
#[derive(Debug)]
pub struct Network {
    role: Role,
    file: PathBuf,
    digest: Digest,
    spec: Spec,
    session: Session,
}

/// A declared input of a network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Port {
    /// Name in the file.
    pub name: String,
    /// Axes: a number if fixed by the file. `None` if even the number of axes is free.
    pub shape: Option<Vec<Option<usize>>>,
}

impl Network {
    /// Loads `file`, and verifies its SHA-256 if `spec` has one.
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

    /// Role.
    pub fn role(&self) -> Role {
        self.role
    }

    /// Path of the file.
    pub fn file(&self) -> &Path {
        &self.file
    }

    /// SHA-256 of the file, for reports.
    pub fn digest(&self) -> Digest {
        self.digest
    }

    /// Description in `networks.yaml`.
    pub fn spec(&self) -> &Spec {
        &self.spec
    }

    /// Inputs in the file's order.
    pub fn inputs(&self) -> &[Port] {
        self.session.inputs()
    }

    /// Names of the outputs in the file's order.
    pub fn outputs(&self) -> &[String] {
        self.session.outputs()
    }

    /// Runs once, with all inputs in the file's order; returns all outputs, which are finite.
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

    /// Inputs per run: fixed by the file, else from `networks.yaml`.
    pub(crate) fn batch(&self) -> usize {
        self.fixed_batch().unwrap_or(self.spec.batch).max(1)
    }

    /// Inputs per run, if fixed by the file.
    pub(crate) fn fixed_batch(&self) -> Option<usize> {
        *self.inputs().first()?.shape.as_ref()?.first()?
    }

    /// Preparation of pictures.
    pub(crate) fn input(&self) -> &Input {
        &self.spec.input
    }

    /// Order of axes; the check of the role has set it.
    pub(crate) fn layout(&self) -> Layout {
        self.spec.input.layout.unwrap_or(Layout::Nchw)
    }

    /// Prepares one picture.
    pub(crate) fn prepare(&self, picture: &RgbImage) -> Result<Prepared> {
        self.input()
            .prepare(picture)
            .map_err(|(expected, found)| self.wrong("picture (width x height)", expected, found))
    }

    /// Arranges pictures as one input.
    pub(crate) fn arrange(&self, pictures: &[Prepared], frames: Option<usize>) -> Result<Tensor> {
        arranged(pictures, self.layout(), frames).ok_or_else(|| {
            let expected = "pictures of one size in a run".to_owned();
            self.wrong("pictures", expected, "several sizes, or none".to_owned())
        })
    }

    /// Index of an output of [`Network::run`].
    pub(crate) fn index_of(&self, output: &Output, key: &str) -> Result<usize> {
        let names = self.outputs();
        let (found, requested) = match output {
            Output::Index(index) => ((*index < names.len()).then_some(*index), index.to_string()),
            Output::Name(name) => (names.iter().position(|other| other == name), name.clone()),
        };
        found.ok_or_else(|| {
            self.shape_error(key, format!("one of {names:?}"), format!("`{requested}`"))
        })
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
        Err(self.shape_error(
            "inputs",
            format!("{count}: {what}"),
            format!("{}: {names:?}", names.len()),
        ))
    }

    pub(crate) fn shape_error(
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
                return Err(self.shape_error(
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
