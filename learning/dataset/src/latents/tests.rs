use std::{
    fs,
    sync::atomic::{AtomicUsize, Ordering::Relaxed},
};

use candle_core::Tensor;
use wm_model::Result;

use super::*;
use crate::{Data, DataOptions};

/// Two channels: the red of each pixel, and 0.5.
struct Red(LatentSpace);

impl Encoder for Red {
    fn space(&self) -> &LatentSpace {
        &self.0
    }

    fn input_size(&self) -> (usize, usize) {
        (16, 16)
    }

    fn encode(&self, images: &Tensor) -> Result<Tensor> {
        let red = images.narrow(3, 0, 1)?;
        let half = (red.zeros_like()? + 0.5)?;
        Ok(Tensor::cat(&[red, half], 3)?)
    }
}

#[test]
fn other_split_finds_its_latents_and_statistics() {
    let dir = tempfile::tempdir().unwrap();
    let bags = dir.path().join("bags");
    let frames = |name: &str, reds: &[u8]| {
        crate::testing::write_reds(&bags.join(name), reds);
    };
    frames("a", &[0, 255, 0, 255]);
    frames("b", &[51, 51, 51]);
    let cache = dir.path().join("cache");
    let space = LatentSpace {
        name: "red".into(),
        hash: "00".into(),
        height: 16,
        width: 16,
        channels: 2,
    };
    let encoder = Red(space);
    let mut made: Vec<PathBuf> = Vec::new();
    for seed in 0..4 {
        let options = DataOptions {
            validation: Some(0.5),
            validation_seed: Some(seed),
            ..DataOptions::default()
        };
        let data = Data::open(std::slice::from_ref(&bags), (16, 16), &cache, &options).unwrap();
        let latents = Latents::open(&data.training, &encoder, &cache).unwrap();
        let statistics = latents.statistics().unwrap();
        let (mean, std) = match latents.episodes()[0].name.as_str() {
            "a" => (0.5, 0.5),
            _ => (0.2, 0.0),
        };
        // f16 precision.
        assert!((statistics.mean[0] - mean).abs() < 1e-3, "{statistics:?}");
        assert!((statistics.std[0] - std).abs() < 1e-3, "{statistics:?}");
        assert_eq!((statistics.mean[1], statistics.std[1]), (0.5, 0.0));
        let entries = fs::read_dir(&cache).unwrap();
        let mut found: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
        found.sort();
        assert!(made.is_empty() || made == found, "{found:?}");
        made = found;
    }
}

/// Each frame's red, and the mean of its batch, so that latents depend on the batch.
struct OfBatch {
    space: LatentSpace,
    encoded: AtomicUsize,
}

impl OfBatch {
    fn new() -> Self {
        let space = LatentSpace {
            name: "of_batch".into(),
            hash: "01".into(),
            height: 4,
            width: 4,
            channels: 2,
        };
        let encoded = AtomicUsize::new(0);
        Self { space, encoded }
    }
}

impl Encoder for OfBatch {
    fn space(&self) -> &LatentSpace {
        &self.space
    }

    fn input_size(&self) -> (usize, usize) {
        (4, 4)
    }

    fn encode(&self, images: &Tensor) -> Result<Tensor> {
        self.encoded.fetch_add(images.dim(0)?, Relaxed);
        let red = images.narrow(3, 0, 1)?;
        let mean = red.mean_all()?.broadcast_as(red.shape())?;
        Ok(Tensor::cat(&[red, mean], 3)?)
    }
}

/// 75 frames, which are five batches, and the encoded frames by cache.
struct Bench {
    dir: tempfile::TempDir,
    dataset: Dataset,
}

impl Bench {
    fn new() -> Self {
        let dir = tempfile::tempdir().unwrap();
        let bags = dir.path().join("bags");
        let reds: Vec<u8> = (0..75).map(|frame| frame * 3).collect();
        crate::testing::write_reds(&bags.join("bag"), &reds);
        let dataset = Dataset::open(&bags, &dir.path().join("frames"), (4, 4)).unwrap();
        Self { dir, dataset }
    }

    /// The files of a shard, and the number of frames encoded for them.
    fn shard(&self, cache: &str, shard: &str) -> anyhow::Result<(Vec<PathBuf>, usize)> {
        let encoder = OfBatch::new();
        let cache = self.dir.path().join(cache);
        let shard = shard.parse().unwrap();
        let files = Latents::encode_shard(&self.dataset, &encoder, &cache, shard)?;
        Ok((files, encoder.encoded.into_inner()))
    }

    /// The bytes of the only remaining file, and the number of frames encoded for it.
    fn whole(&self, cache: &str) -> anyhow::Result<(Vec<u8>, usize)> {
        let encoder = OfBatch::new();
        let cache = self.dir.path().join(cache);
        let latents = Latents::open(&self.dataset, &encoder, &cache)?;
        let files: Vec<_> = fs::read_dir(cache).unwrap().collect();
        assert_eq!(files.len(), 1, "{files:?}");
        let bytes = fs::read(files[0].as_ref().unwrap().path()).unwrap();
        assert_eq!(bytes, latents.files[0][..]);
        Ok((bytes, encoder.encoded.into_inner()))
    }
}

#[test]
fn latents_of_shards_equal_those_of_one_run() {
    let bench = Bench::new();
    let (one, encoded) = bench.whole("one").unwrap();
    assert_eq!(encoded, 75);
    for count in [1, 2, 3, 7] {
        let cache = format!("of_{count}");
        let mut total = 0;
        for index in 0..count {
            let shard = format!("{index}/{count}");
            let (files, encoded) = bench.shard(&cache, &shard).unwrap();
            assert_eq!(files.len(), usize::from(index < 5), "{shard}: five batches");
            assert_eq!(bench.shard(&cache, &shard).unwrap(), (files, 0));
            total += encoded;
        }
        assert_eq!(total, 75);
        assert!(bench.whole(&cache).unwrap() == (one.clone(), 0), "{cache}");
        // Nothing is left to encode.
        let (files, encoded) = bench.shard(&cache, "0/2").unwrap();
        let name = files[0].to_str().unwrap();
        assert!(encoded == 0 && !name.contains("frames-0"), "{name}");
    }
}

#[test]
fn only_missing_batches_are_encoded() {
    let bench = Bench::new();
    let (one, _) = bench.whole("one").unwrap();
    // Frames 0 to 31 and 64 to 74 of 75.
    assert_eq!(bench.shard("missing", "0/3").unwrap().1, 32);
    assert_eq!(bench.shard("missing", "2/3").unwrap().1, 11);
    assert!(bench.whole("missing").unwrap() == (one.clone(), 32));
    // Frames 0 to 47; the other part has the last 16 too and encodes 48 to 63.
    assert_eq!(bench.shard("overlapping", "0/2").unwrap().1, 48);
    assert_eq!(bench.shard("overlapping", "1/3").unwrap().1, 16);
    assert!(bench.whole("overlapping").unwrap() == (one.clone(), 11));
    // A part that ends within a batch, as from another batch size: frames 0 to 19.
    let file = bench.shard("shifted", "0/2").unwrap().0.remove(0);
    let latents = fs::read(&file).unwrap();
    fs::remove_file(&file).unwrap();
    let shifted = file.with_extension("frames-0-20");
    fs::write(shifted, &latents[..latents.len() / 48 * 20]).unwrap();
    assert!(bench.whole("shifted").unwrap() == (one, 75 - 16));
}

#[test]
fn wrong_length_of_a_part_is_named() {
    let bench = Bench::new();
    let file = bench.shard("cut", "1/3").unwrap().0.remove(0);
    let latents = fs::read(&file).unwrap();
    let is_refused = |file: &Path| {
        let name = file.file_name().unwrap().to_str().unwrap();
        for error in [bench.whole("cut").err(), bench.shard("cut", "1/3").err()] {
            let error = error.unwrap().to_string();
            assert!(error.contains(name) && error.contains("remove"), "{error}");
        }
    };
    fs::write(&file, &latents[1..]).unwrap();
    is_refused(&file);
    // Frames beyond the end.
    let beyond = file.with_extension("frames-64-32");
    fs::rename(&file, &beyond).unwrap();
    fs::write(&beyond, &latents).unwrap();
    is_refused(&beyond);
    // A partial file of a stopped program is ignored.
    let partial = file.with_extension("frames-64-32.partial-0");
    fs::rename(&beyond, &partial).unwrap();
    assert_eq!(bench.shard("cut", "0/3").unwrap().1, 32);
}
