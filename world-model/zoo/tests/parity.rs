//! Every kind of model against PyTorch: the fixtures of fixtures/generate.py, with both engines, and on a GPU in a build for
//! it.

#![allow(clippy::unwrap_used)] // the helpers of tests too, not only what is marked #[test]

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use candle_core::{DType, Device, Tensor};
use wm_model::sampler::Sampler;
use wm_model::{Compute, Kernels, NumberFormat};
use wm_zoo::Checkpoint;
use wm_zoo::kinds::{Kind, RolloutOptions, Tensors, forward, rollout};

/// Number formats of the weights, each with the error allowed.
///
/// f32 leaves room for sums in another order, bf16 for its 8 bits; both are the task's bounds. Those of int8 are what
/// `docs/models.md` promises: weights are random here, and there is no calibration.
const PRECISIONS: [(NumberFormat, RelativeError); 3] = [
    (NumberFormat::F32, RelativeError::both(1e-4)),
    (NumberFormat::Bf16, RelativeError::both(2e-2)),
    (
        NumberFormat::Int8,
        RelativeError {
            of_norm: 3e-2,
            of_largest: 5e-2,
        },
    ),
];

/// What a folder's name has between its kind and the variant of it.
const VARIANT: &str = "--";

/// Environment variables with the paths of weights that are not part of the repository. Fixtures of
/// these kinds are passed over, with a word on it, where the variable is not set.
const EXTERNAL_WEIGHTS: [(Kind, &str); 1] =
    [(Kind::EfficientNetLite0, "WM_EFFICIENTNET_LITE0_WEIGHTS")];

type Outcome<T> = Result<T, String>;

/// One folder of fixtures.
struct Fixture {
    folder: PathBuf,
}

impl Fixture {
    fn name(&self) -> &str {
        self.folder.file_name().unwrap().to_str().unwrap()
    }

    fn kind(&self) -> &str {
        let name = self.name();
        name.split_once(VARIANT).map_or(name, |(kind, _)| kind)
    }

    fn text(&self, file: &str) -> Option<String> {
        std::fs::read_to_string(self.folder.join(file)).ok()
    }

    fn tensors(&self, file: &str) -> Outcome<Tensors> {
        let path = self.folder.join(file);
        let tensors = candle_core::safetensors::load(path, &Device::Cpu).map_err(text)?;
        Ok(tensors.into_iter().collect())
    }

    /// The weights; nothing if they are of those that are not part of the repository.
    fn checkpoint(&self) -> Outcome<Option<Checkpoint>> {
        let in_folder = ["weights.safetensors", "weights.pt"].map(|file| self.folder.join(file));
        let kind: Kind = self.kind().parse().map_err(text)?;
        let external = EXTERNAL_WEIGHTS.iter().find(|(of, _)| *of == kind);
        let path = match (in_folder.into_iter().find(|path| path.exists()), external) {
            (Some(path), _) => path,
            (None, Some((_, variable))) => match std::env::var_os(variable) {
                Some(path) => path.into(),
                None => {
                    eprintln!("{}: skipped, {variable} is not set", self.name());
                    return Ok(None);
                }
            },
            (None, None) => return Err("no weights".to_owned()),
        };
        Checkpoint::open(path).map(Some).map_err(text)
    }

    /// What `compute` makes of the input, by each way that has to give the same.
    fn outputs(&self, compute: &Compute) -> Outcome<Vec<Tensors>> {
        let Some(checkpoint) = self.checkpoint()? else {
            return Ok(Vec::new());
        };
        let config = self.text("config.json").ok_or("no config.json")?;
        let inputs = self.tensors("input.safetensors")?;
        let Some(options) = self.text("options.json") else {
            let kind: Kind = self.kind().parse().map_err(text)?;
            let outputs = forward(kind, &config, &checkpoint, &inputs, compute);
            return Ok(vec![outputs.map_err(text)?]);
        };
        let sampler: Sampler = serde_json::from_str(&options).map_err(text)?;
        [true, false]
            .into_iter()
            .map(|cache| {
                let sampler = sampler.clone();
                let options = RolloutOptions { sampler, cache };
                rollout(&config, &checkpoint, &inputs, &options, compute).map_err(text)
            })
            .collect()
    }

    /// Everything that differs from PyTorch, one line each; empty if nothing does.
    fn faults(&self, (format, tolerance): &(NumberFormat, RelativeError)) -> Vec<String> {
        let mut faults = Vec::new();
        for compute in computes(*format) {
            let compared = self.outputs(&compute).and_then(|all| {
                let expected = self.tensors("output.safetensors")?;
                let found = all.iter().map(|found| compare(found, &expected));
                found.collect::<Outcome<Vec<_>>>()
            });
            let label = format!("{} with {compute}", self.name());
            match compared {
                Ok(errors) => {
                    for (output, error) in errors.iter().flatten() {
                        println!("{label}: {output} {error}");
                        if !error.is_within(tolerance) {
                            faults.push(format!("{label}: {output} {error}"));
                        }
                    }
                }
                Err(reason) => faults.push(format!("{label}: {reason}")),
            }
        }
        faults
    }
}

/// All kernels on the CPU and, in a build for it, the first GPU, if they compute in this number format.
fn computes(format: NumberFormat) -> Vec<Compute> {
    let on_cpu = [Kernels::Candle, Kernels::Cpu].map(Compute::on_cpu);
    #[cfg(not(feature = "cuda"))]
    let on_gpu = None;
    #[cfg(feature = "cuda")]
    let on_gpu = {
        let gpu: Compute = "cuda".parse().unwrap();
        let missing = gpu.device().err();
        if let Some(missing) = &missing {
            eprintln!("GPU: skipped, {missing}");
        }
        missing.is_none().then_some(gpu)
    };
    let all = on_cpu.into_iter().chain(on_gpu);
    all.filter_map(|compute| compute.with_format(format).ok())
        .collect()
}

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}

/// How far an output is from PyTorch's in f32.
struct RelativeError {
    /// Norm of the difference over norm of the output.
    of_norm: f64,
    /// Largest difference over largest output.
    of_largest: f64,
}

impl RelativeError {
    const fn both(error: f64) -> Self {
        Self {
            of_norm: error,
            of_largest: error,
        }
    }

    fn between(found: &Tensor, expected: &Tensor) -> candle_core::Result<Self> {
        let difference = (found.to_dtype(DType::F64)? - expected.to_dtype(DType::F64)?)?;
        let expected = expected.to_dtype(DType::F64)?;
        let norm = |x: &Tensor| x.sqr()?.sum_all()?.sqrt()?.to_scalar::<f64>();
        let largest = |x: &Tensor| x.abs()?.max_all()?.to_scalar::<f64>();
        Ok(Self {
            of_norm: norm(&difference)? / norm(&expected)?,
            of_largest: largest(&difference)? / largest(&expected)?,
        })
    }

    /// False also where something is not a number.
    fn is_within(&self, tolerance: &Self) -> bool {
        self.of_norm <= tolerance.of_norm && self.of_largest <= tolerance.of_largest
    }
}

impl std::fmt::Display for RelativeError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "is off by {:.1e} of the norm, {:.1e} of the largest value",
            self.of_norm, self.of_largest
        )
    }
}

/// The error of each output, by name; names, shapes and number formats have to agree.
fn compare(found: &Tensors, expected: &Tensors) -> Outcome<Vec<(String, RelativeError)>> {
    let signature = |tensors: &Tensors| -> Vec<String> {
        let of = |(name, t): (&String, &Tensor)| format!("{name} {:?} {:?}", t.dims(), t.dtype());
        tensors.iter().map(of).collect()
    };
    let (found_signature, expected_signature) = (signature(found), signature(expected));
    if found_signature != expected_signature {
        return Err(format!(
            "gives {found_signature:?}, expected {expected_signature:?}"
        ));
    }
    let pairs = found.iter().zip(expected.values());
    pairs
        .map(|((name, found), expected)| {
            let error = RelativeError::between(found, expected).map_err(text)?;
            Ok((name.clone(), error))
        })
        .collect()
}

fn fixtures() -> Vec<Fixture> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures");
    let folders = std::fs::read_dir(root)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut folders: Vec<PathBuf> = folders.filter(|path| path.is_dir()).collect();
    folders.sort();
    folders
        .into_iter()
        .map(|folder| Fixture { folder })
        .collect()
}

fn assert_parity(format: &(NumberFormat, RelativeError)) {
    let fixtures = fixtures();
    let faults: Vec<String> = fixtures.iter().flat_map(|f| f.faults(format)).collect();
    let count = faults.len();
    assert!(faults.is_empty(), "{count} faults:\n{}", faults.join("\n"));
}

#[test]
fn every_kind_gives_what_pytorch_gives() {
    assert_parity(&PRECISIONS[0]);
}

#[test]
fn every_kind_is_close_with_weights_of_half_the_size() {
    assert_parity(&PRECISIONS[1]);
}

#[test]
fn every_kind_is_near_with_weights_of_a_quarter_of_the_size() {
    assert_parity(&PRECISIONS[2]);
}

#[test]
fn every_kind_has_a_fixture_and_every_fixture_a_kind() {
    let fixtures = fixtures();
    let with_fixture: BTreeSet<&str> = fixtures.iter().map(Fixture::kind).collect();
    let kinds: BTreeSet<&str> = Kind::ALL.iter().map(|kind| kind.name()).collect();
    let missing: Vec<_> = kinds.difference(&with_fixture).collect();
    let unknown: Vec<_> = with_fixture.difference(&kinds).collect();
    assert!(
        missing.is_empty() && unknown.is_empty(),
        "tests/fixtures lacks {missing:?} (fixtures/generate.py makes them), has unknown {unknown:?}"
    );
    assert!(
        fixtures
            .iter()
            .any(|fixture| fixture.text("options.json").is_some()),
        "no rollout among the fixtures"
    );
}
