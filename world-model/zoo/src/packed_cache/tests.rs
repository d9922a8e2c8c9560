use std::fs::{self, File};
use std::path::Path;
use std::sync::Barrier;
use std::time::SystemTime;

use candle_core::{DType, Device, Tensor};
use proptest::prelude::*;
use safetensors::tensor::{Dtype, TensorView};
use wm_model::{Compute, NumberFormat};

use super::header::{Header, Matrix, Refusal};
use super::identity::Identity;
use super::packed_file::PackedFile;
use super::*;
use crate::{Checkpoint, Loader};

/// Outputs and inputs: the last one fills large pages.
const SHAPES: [(usize, usize); 3] = [(48, 40), (100, 48), (600, 1000)];

const ALL: CacheLimits = CacheLimits {
    least: 0,
    most: u64::MAX,
    settled: Duration::ZERO,
};

/// A checkpoint of three Linears, and a cache that has nothing yet.
struct Place {
    root: tempfile::TempDir,
}

impl Place {
    fn new() -> Self {
        let place = Self {
            root: tempfile::tempdir().unwrap(),
        };
        fs::write(place.weights(), checkpoint(1)).unwrap();
        place
    }

    fn weights(&self) -> PathBuf {
        self.root.path().join("weights.safetensors")
    }

    fn cache(&self, limits: CacheLimits) -> PackedCache {
        PackedCache::new(self.root.path().join("cache/packed"), limits)
    }

    /// Outputs of the Linears, loaded through a cache, and what is in it then.
    fn load(&self, limits: CacheLimits) -> (Vec<Vec<u32>>, Vec<PathBuf>) {
        let cache = self.cache(limits);
        let outputs = outputs(&self.weights(), Some(cache.clone()), NumberFormat::F32);
        cache.wait();
        (outputs, files(cache.folder()))
    }

    /// The one file of packed weights.
    fn packed(&self) -> PathBuf {
        let [file] = files(self.cache(ALL).folder()).try_into().unwrap();
        file
    }

    fn identity(&self) -> Identity {
        let checkpoint = Checkpoint::open(self.weights()).unwrap();
        Identity {
            state: checkpoint.stamp().unwrap().state,
            contents: checkpoint.fingerprint(),
        }
    }

    fn refusal(&self) -> String {
        let opened = PackedFile::open(&self.packed(), &self.identity());
        opened.unwrap_err().to_string()
    }
}

/// A safetensors file; `seed` decides the values.
fn checkpoint(seed: usize) -> Vec<u8> {
    let values = |count: usize| -> Vec<u8> {
        (0..count)
            .map(|i| ((i * 7919 + seed * 104_729) % 2003) as f32 / 1001.0 - 1.0)
            .flat_map(f32::to_le_bytes)
            .collect()
    };
    let mut tensors = Vec::new();
    for (i, (outputs, inputs)) in SHAPES.into_iter().enumerate() {
        let weight = (vec![outputs, inputs], values(outputs * inputs));
        tensors.push((format!("{i}.weight"), weight));
        tensors.push((format!("{i}.bias"), (vec![outputs], values(outputs))));
    }
    let views = tensors.iter().map(|(name, (shape, bytes))| {
        let view = TensorView::new(Dtype::F32, shape.clone(), bytes);
        (name.as_str(), view.unwrap())
    });
    safetensors::serialize(views, None).unwrap()
}

/// What the Linears of a checkpoint make of ones, as bits.
fn outputs(weights: &Path, cache: Option<PackedCache>, format: NumberFormat) -> Vec<Vec<u32>> {
    let checkpoint = Checkpoint::open(weights).unwrap();
    let compute = Compute::default().with_format(format).unwrap();
    let mut loader = Loader::new(&checkpoint, &compute).unwrap();
    if let Some(cache) = cache {
        loader = loader.cached(cache);
    }
    let linears = SHAPES
        .into_iter()
        .enumerate()
        .map(|(i, (outputs, inputs))| {
            let linear = loader.linear(&i.to_string(), inputs, outputs).unwrap();
            let x = Tensor::ones((2, inputs), DType::F32, &Device::Cpu).unwrap();
            let y = linear.forward(&x).unwrap().flatten_all().unwrap();
            let y: Vec<f32> = y.to_vec1().unwrap();
            y.into_iter().map(f32::to_bits).collect()
        });
    let outputs = linears.collect();
    loader.finish().unwrap();
    outputs
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = fs::read_dir(folder) else {
        return Vec::new();
    };
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

/// Which file it is: a new one in its place has another inode.
fn inode(path: &Path) -> u64 {
    use std::os::unix::fs::MetadataExt as _;
    fs::metadata(path).unwrap().ino()
}

/// Puts a file with other bytes into the place of one that is read-only, and may be mapped.
fn replace(path: &Path, bytes: &[u8]) {
    fs::remove_file(path).unwrap();
    fs::write(path, bytes).unwrap();
}

#[test]
fn what_was_kept_gives_the_same_bits() {
    let place = Place::new();
    for format in NumberFormat::ALL {
        let load = || {
            let cache = place.cache(ALL);
            let outputs = outputs(&place.weights(), Some(cache.clone()), format);
            cache.wait();
            outputs
        };
        let expected = outputs(&place.weights(), None, format);
        assert_eq!(load(), expected, "packed");
        let before: Vec<u64> = files(place.cache(ALL).folder())
            .iter()
            .map(|f| inode(f))
            .collect();
        assert_eq!(load(), expected, "found again");
        let after: Vec<u64> = files(place.cache(ALL).folder())
            .iter()
            .map(|f| inode(f))
            .collect();
        assert_eq!(before, after, "written once");
    }
    let kept = files(place.cache(ALL).folder());
    assert_eq!(kept.len(), 3, "one for each format: {kept:?}");
    for file in kept {
        assert!(fs::metadata(&file).unwrap().permissions().readonly());
    }
}

#[test]
fn values_come_from_the_kept_file() {
    let place = Place::new();
    place.load(ALL);
    let identity = place.identity();
    let kept = PackedFile::open(&place.packed(), &identity)
        .unwrap()
        .unwrap();
    let checkpoint = Checkpoint::open(place.weights()).unwrap();
    for (i, shape) in SHAPES.into_iter().enumerate() {
        let name = format!("{i}.weight");
        let linear = |name, shape, format| kept.linear(name, shape, format, None);
        let found = linear(&name, shape, NumberFormat::F32).unwrap();
        let packed = checkpoint.with_values(&name, false, |values| {
            wm_model::ops::PackedLinear::new(values, None, shape, NumberFormat::F32).unwrap()
        });
        assert_eq!(found.packed_parts(), packed.unwrap().packed_parts());
        let start = found.packed_parts()[0].as_ptr();
        assert_eq!(start.align_offset(64), 0, "whole cache lines");
        let other = (shape.1, shape.0);
        assert!(linear(&name, other, NumberFormat::F32).is_none());
        assert!(linear(&name, shape, NumberFormat::Bf16).is_none());
        assert!(linear("another", shape, NumberFormat::F32).is_none());
    }
}

#[test]
fn every_damage_is_refused_and_mended() {
    let place = Place::new();
    let (expected, _) = place.load(ALL);
    let file = place.packed();
    let whole = fs::read(&file).unwrap();
    let header = Header::decode(&whole).unwrap();
    let first = header.matrices[0].start as usize;

    let mut lengths: Vec<usize> = (0..first).step_by(37).collect();
    for matrix in &header.matrices {
        let (start, end) = (matrix.start, matrix.start + matrix.bytes);
        lengths.extend([start - 1, start, start + 1, end - 1].map(|at| at as usize));
    }
    for length in lengths {
        replace(&file, &whole[..length]);
        let refusal = place.refusal();
        assert!(!refusal.is_empty(), "{length} bytes");
    }
    replace(&file, &[whole.clone(), vec![0]].concat());
    assert!(place.refusal().contains("bytes, expected"));

    let described = header.encode().unwrap().len();
    let flips = (0..described).chain(header.matrices.iter().flat_map(|matrix| {
        let (start, end) = (
            matrix.start as usize,
            (matrix.start + matrix.bytes) as usize,
        );
        [start, start + 1234, end - 1]
    }));
    // One file, mapped and checked anew for each.
    for at in flips {
        let mut damaged = whole.clone();
        damaged[at] ^= 0x10;
        let refused = match Header::decode(&damaged) {
            Err(_) => true,
            Ok(header) => header.matrices.iter().any(|matrix| {
                let place = matrix.start as usize..(matrix.start + matrix.bytes) as usize;
                crc32fast::hash(&damaged[place]) != matrix.crc32
            }),
        };
        assert!(refused, "byte {at} flipped");
    }

    let mut damaged = whole.clone();
    damaged[header.matrices[2].start as usize + 99] ^= 1;
    replace(&file, &damaged);
    assert_eq!(place.refusal(), "`2.weight` is damaged");
    let before = inode(&file);
    let (outputs, _) = place.load(ALL);
    assert_eq!(outputs, expected);
    assert_ne!(inode(&place.packed()), before, "written anew");
    assert_eq!(fs::read(&file).unwrap(), whole);
}

#[test]
fn what_is_of_another_program_is_refused_and_mended() {
    let place = Place::new();
    let (expected, _) = place.load(ALL);
    let file = place.packed();
    let whole = fs::read(&file).unwrap();
    let with_header = |change: &dyn Fn(&mut Header)| {
        let mut header = Header::decode(&whole).unwrap();
        change(&mut header);
        let mut bytes = header.encode().unwrap();
        bytes.extend_from_slice(&whole[bytes.len()..]);
        bytes
    };
    let layout = Header::decode(&whole).unwrap().layout;
    let (_, processor) = layout.split_once(' ').unwrap();
    let other = format!("7 {processor}");
    let mut version = whole.clone();
    version[8] = 9;
    let cases = [
        (
            with_header(&|header| header.layout.clone_from(&other)),
            "packed as 7 ",
        ),
        (
            with_header(&|header| header.identity.contents = "0".repeat(64)),
            "checkpoint",
        ),
        (
            with_header(&|header| header.matrices[1].start += 64),
            "`1.weight` does not lie",
        ),
        (version, "version 9, expected 1"),
        (b"{\"some\": \"other file\"}".to_vec(), "no file of packed"),
        (Vec::new(), "no file of packed"),
        (vec![0; 5000], "no file of packed"),
    ];
    for (bytes, reason) in cases {
        replace(&file, &bytes);
        let refusal = place.refusal();
        assert!(refusal.contains(reason), "{refusal}, expected {reason}");
        assert_eq!(place.load(ALL).0, expected, "{reason}");
        assert_eq!(fs::read(place.packed()).unwrap(), whole, "{reason}");
    }
    // Not a file at all: neither used nor deleted.
    fs::remove_file(&file).unwrap();
    fs::create_dir(&file).unwrap();
    assert_eq!(place.load(ALL).0, expected);
    assert!(file.is_dir());
}

#[test]
fn other_weights_of_the_same_size_are_packed_anew() {
    let place = Place::new();
    let (first, _) = place.load(ALL);
    let modified = fs::metadata(place.weights()).unwrap().modified().unwrap();
    let reload = |what: &str, seed: usize| {
        // Even if somebody sets the time back.
        let file = File::options().write(true).open(place.weights()).unwrap();
        file.set_modified(modified).unwrap();
        let expected = outputs(&place.weights(), None, NumberFormat::F32);
        assert_eq!(place.refusal(), Refusal::Checkpoint.to_string(), "{what}");
        let (found, files) = place.load(ALL);
        assert_eq!(found, expected, "{what}");
        assert_eq!(files.len(), 1, "{what}: in the place of the old one");
        assert_eq!(found == first, seed == 1, "{what}");
    };
    fs::write(place.weights(), checkpoint(2)).unwrap();
    reload("rewritten", 2);
    let other = place.root.path().join("other");
    fs::write(&other, checkpoint(1)).unwrap();
    fs::rename(&other, place.weights()).unwrap();
    reload("renamed", 1);
}

#[test]
fn limits_hold() {
    let place = Place::new();
    let (expected, files) = place.load(ALL);
    let bytes = fs::metadata(&files[0]).unwrap().len();
    let empty = |what: &str, limits| {
        let place = Place::new();
        let (outputs, files) = place.load(limits);
        assert_eq!(outputs, expected, "{what}");
        assert!(files.is_empty(), "{what}: {files:?}");
    };
    empty(
        "few values",
        CacheLimits {
            least: bytes,
            ..ALL
        },
    );
    empty(
        "too many values",
        CacheLimits {
            most: bytes / 2,
            ..ALL
        },
    );
    let settled = Duration::from_secs(3600);
    empty("just written", CacheLimits { settled, ..ALL });
}

#[test]
fn what_was_not_used_for_longest_makes_room() {
    let place = Place::new();
    let cache = place.cache(ALL);
    place.load(ALL);
    let old = place.packed();
    let bytes = fs::metadata(&old).unwrap().len();
    let (older, newer) = (
        cache.folder().join("b.packed"),
        cache.folder().join("a.packed"),
    );
    let unknown = cache.folder().join("notes.txt");
    let hour = Duration::from_secs(3600);
    for (path, age) in [(&older, 3), (&newer, 1), (&unknown, 9)] {
        let file = File::create(path).unwrap();
        file.set_len(bytes).unwrap();
        file.set_modified(SystemTime::now() - hour * age).unwrap();
    }
    File::open(&old)
        .unwrap()
        .set_modified(SystemTime::now() - hour * 5)
        .unwrap();
    // Being used counts.
    place.load(ALL);
    let most = bytes * 5 / 2;
    fs::write(place.weights(), checkpoint(2)).unwrap();
    place.load(CacheLimits { most, ..ALL });
    let mut expected = vec![old, newer, unknown];
    expected.sort();
    assert_eq!(files(cache.folder()), expected);
}

#[test]
fn a_file_that_another_process_writes_is_left_to_it() {
    let place = Place::new();
    place.load(ALL);
    let file = place.packed();
    let partial = file.with_extension("partial");
    fs::remove_file(&file).unwrap();
    fs::write(&partial, "half").unwrap();
    let (_, found) = place.load(ALL);
    assert_eq!(found, std::slice::from_ref(&partial), "left alone");
    assert_eq!(fs::read(&partial).unwrap(), b"half");
    // Its writer ended long ago.
    let long_ago = SystemTime::now() - Duration::from_secs(3600);
    let abandoned = File::options().write(true).open(&partial).unwrap();
    abandoned.set_modified(long_ago).unwrap();
    let (_, found) = place.load(ALL);
    assert_eq!(found, [file]);
}

#[test]
fn a_folder_that_cannot_be_written_changes_nothing() {
    let place = Place::new();
    let expected = outputs(&place.weights(), None, NumberFormat::F32);
    // No folder can be created below a file, by whoever.
    let blocked = place.root.path().join("blocked");
    fs::write(&blocked, "").unwrap();
    let cache = PackedCache::new(blocked.join("packed"), ALL);
    for _ in 0..2 {
        let found = outputs(&place.weights(), Some(cache.clone()), NumberFormat::F32);
        cache.wait();
        assert_eq!(found, expected);
    }
    assert_eq!(fs::read(&blocked).unwrap(), b"");
}

#[test]
fn loaders_side_by_side_agree() {
    let place = Place::new();
    let expected = outputs(&place.weights(), None, NumberFormat::F32);
    for round in 0..3 {
        let barrier = Barrier::new(8);
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| {
                    barrier.wait();
                    // Each with a cache of its own, as processes have.
                    let (outputs, _) = place.load(ALL);
                    assert_eq!(outputs, expected, "round {round}");
                });
            }
        });
        place.packed();
    }
}

#[test]
fn weights_that_are_no_file_are_not_kept() {
    let place = Place::new();
    let checkpoint = Checkpoint::from_bytes("memory", checkpoint(1)).unwrap();
    assert!(Session::new(place.cache(ALL), &checkpoint, NumberFormat::F32).is_none());
}

fn matrices() -> impl Strategy<Value = Vec<Matrix>> {
    let format = prop_oneof![
        Just(NumberFormat::F32),
        Just(NumberFormat::Bf16),
        Just(NumberFormat::Int8)
    ];
    let matrix = (
        ".{0,20}",
        any::<(usize, usize)>(),
        format,
        0u64..5000,
        any::<u32>(),
    );
    let matrix = matrix.prop_map(|(name, (outputs, inputs), format, bytes, crc32)| Matrix {
        name,
        outputs,
        inputs,
        format,
        start: 0,
        bytes,
        crc32,
    });
    prop::collection::vec(matrix, 1..9)
}

fn arranged(matrices: Vec<Matrix>, weights: String) -> (Header, Vec<u8>) {
    let mut header = Header {
        weights,
        identity: Place::new().identity(),
        layout: wm_model::ops::packed_layout(),
        matrices,
        length: 0,
    };
    header.arrange().unwrap();
    let mut bytes = header.encode().unwrap();
    assert!(bytes.len() as u64 <= header.matrices[0].start);
    bytes.resize(header.length as usize, 0);
    (header, bytes)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_header_is_read_back(matrices in matrices(), weights in ".{0,40}") {
        let (header, bytes) = arranged(matrices, weights);
        prop_assert_eq!(Header::decode(&bytes).unwrap(), header);
    }

    #[test]
    fn matrices_are_apart_and_aligned(matrices in matrices()) {
        let (header, _) = arranged(matrices, String::new());
        for pair in header.matrices.windows(2) {
            prop_assert!(pair[0].start + pair[0].bytes <= pair[1].start);
        }
        prop_assert!(header.matrices.iter().all(|m| m.start % super::header::ALIGNMENT == 0));
    }

    #[test]
    fn a_place_beyond_the_file_is_refused(
        matrices in matrices(),
        start in any::<u64>(),
        bytes in any::<u64>(),
    ) {
        let (mut header, whole) = arranged(matrices, String::new());
        header.matrices[0].start = start;
        header.matrices[0].bytes = bytes;
        let mut damaged = header.encode().unwrap();
        damaged.resize(whole.len().max(damaged.len()), 0);
        if let Ok(header) = Header::decode(&damaged) {
            for matrix in header.matrices {
                let end = matrix.start.checked_add(matrix.bytes).unwrap();
                prop_assert!(end <= damaged.len() as u64);
            }
        }
    }

    #[test]
    fn no_bytes_make_it_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        prop_assert!(Header::decode(&bytes).is_err());
        let with_start = [b"wmpacked\x01\0\0\0", bytes.as_slice()].concat();
        prop_assert!(Header::decode(&with_start).is_err());
    }
}
