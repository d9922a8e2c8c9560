use std::io::{Cursor, Write as _};

use safetensors::tensor::{Dtype, TensorView};
use zip::CompressionMethod;
use zip::write::SimpleFileOptions;

use super::*;

fn f32s(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

fn safetensors_of(tensors: &[(&str, Dtype, &[usize], Vec<u8>)]) -> Vec<u8> {
    let views = tensors.iter().map(|(name, dtype, shape, bytes)| {
        (
            *name,
            TensorView::new(*dtype, shape.to_vec(), bytes).unwrap(),
        )
    });
    safetensors::serialize(views, None).unwrap()
}

/// Writes a value.
type Written<'a> = &'a dyn Fn(&mut Pickler);

/// Writes the pickle of `torch.save`: what protocol 2 makes of the objects, without its memo.
#[derive(Default)]
struct Pickler(Vec<u8>);

impl Pickler {
    fn new() -> Self {
        Self(vec![0x80, 2])
    }

    fn text(&mut self, text: &str) {
        self.0.push(b'X');
        self.0.extend((text.len() as u32).to_le_bytes());
        self.0.extend(text.as_bytes());
    }

    fn global(&mut self, module: &str, name: &str) {
        self.0.extend(format!("c{module}\n{name}\n").as_bytes());
    }

    fn int(&mut self, value: i32) {
        self.0.push(b'J');
        self.0.extend(value.to_le_bytes());
    }

    fn ints(&mut self, values: &[i32]) {
        self.0.push(b'(');
        values.iter().for_each(|value| self.int(*value));
        self.0.push(b't');
    }

    fn tensor(&mut self, class: &str, storage: &str, offset: i32, shape: &[i32], strides: &[i32]) {
        self.global("torch._utils", "_rebuild_tensor_v2");
        self.0.extend(b"((");
        self.text("storage");
        self.global("torch", class);
        self.text(storage);
        self.text("cpu");
        self.int(99);
        self.0.extend(b"tQ");
        self.int(offset);
        self.ints(shape);
        self.ints(strides);
        self.0.push(0x89);
        self.global("collections", "OrderedDict");
        self.0.extend(b")RtR");
    }

    fn dict(&mut self, items: &[(&str, Written<'_>)]) {
        self.0.extend(b"}(");
        for (key, value) in items {
            self.text(key);
            value(self);
        }
        self.0.push(b'u');
    }

    fn finish(mut self) -> Vec<u8> {
        self.0.push(b'.');
        self.0
    }
}

fn torch_file(pickle: Vec<u8>, storages: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let mut add = |name: &str, bytes: &[u8]| {
        archive
            .start_file(format!("archive/{name}"), stored)
            .unwrap();
        archive.write_all(bytes).unwrap();
    };
    add("data.pkl", &pickle);
    add("byteorder", b"little");
    for (name, bytes) in storages {
        add(&format!("data/{name}"), bytes);
    }
    archive.finish().unwrap().into_inner()
}

fn values(checkpoint: &Checkpoint, name: &str) -> Vec<f32> {
    let tensor = checkpoint.tensor(name, DType::F32).unwrap();
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}

#[test]
fn safetensors_of_every_float_format_are_read() {
    let half = |v: f32| half::f16::from_f32(v).to_le_bytes().to_vec();
    let brain = |v: f32| half::bf16::from_f32(v).to_le_bytes().to_vec();
    let file = safetensors_of(&[
        ("a", Dtype::F32, &[2], f32s(&[1.5, -2.0])),
        ("b", Dtype::F16, &[1], half(0.25)),
        ("c", Dtype::BF16, &[1], brain(-8.0)),
        ("d", Dtype::F64, &[], 3.0f64.to_le_bytes().to_vec()),
        ("count", Dtype::I64, &[1], 7i64.to_le_bytes().to_vec()),
    ]);
    let checkpoint = Checkpoint::from_bytes("test", file).unwrap();
    assert_eq!(values(&checkpoint, "a"), [1.5, -2.0]);
    assert_eq!(values(&checkpoint, "b"), [0.25]);
    assert_eq!(values(&checkpoint, "c"), [-8.0]);
    assert_eq!(values(&checkpoint, "d"), [3.0]);
    assert_eq!(
        checkpoint.float_names().collect::<Vec<_>>(),
        ["a", "b", "c", "d"]
    );
    assert_eq!(checkpoint.parameters(), 5);
    let rounded = checkpoint.tensor("a", DType::BF16).unwrap();
    assert_eq!((rounded.dtype(), rounded.dims()), (DType::BF16, &[2][..]));
    let error = checkpoint
        .tensor("count", DType::F32)
        .unwrap_err()
        .to_string();
    assert!(error.contains("count") && error.contains("I64"), "{error}");
}

#[test]
fn a_torch_checkpoint_is_read_in_place() {
    let mut pickle = Pickler::new();
    pickle.dict(&[
        ("model", &|p| {
            p.dict(&[("w", &|p| p.tensor("FloatStorage", "0", 0, &[2, 3], &[3, 1]))]);
        }),
        ("ema", &|p| {
            p.dict(&[
                ("module.w", &|p| {
                    p.tensor("FloatStorage", "0", 6, &[3, 2], &[1, 3]);
                }),
                ("module.n_averaged", &|p| {
                    p.tensor("LongStorage", "1", 0, &[], &[]);
                }),
            ]);
        }),
        ("step", &|p| p.int(1000)),
        ("optimizer", &|p| {
            p.dict(&[("state", &|p| {
                p.dict(&[("0", &|p| p.tensor("FloatStorage", "0", 0, &[1], &[1]))]);
            })]);
        }),
    ]);
    let data: Vec<f32> = (0..12u8).map(f32::from).collect();
    let storages = [("0", f32s(&data)), ("1", 5i64.to_le_bytes().to_vec())];
    let file = torch_file(pickle.finish(), &storages);
    let checkpoint = Checkpoint::from_bytes("test.pt", file).unwrap();
    assert_eq!(checkpoint.parts(), ["ema", "model", "optimizer"]);

    let ema = checkpoint.weights(Average::Ema);
    assert_eq!(ema.names().collect::<Vec<_>>(), ["n_averaged", "w"]);
    // Of a transposed view.
    assert_eq!(values(&ema, "w"), [6.0, 9.0, 7.0, 10.0, 8.0, 11.0]);
    let raw = checkpoint.weights(Average::Raw);
    assert_eq!(values(&raw, "w"), [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out.safetensors");
    let conversion = convert(&ema, &path).unwrap();
    assert_eq!((conversion.tensors, conversion.parameters), (2, 6));
    assert_eq!(conversion.bytes, std::fs::metadata(&path).unwrap().len());
    let again = Checkpoint::open(&path).unwrap();
    assert_eq!(values(&again, "w"), values(&ema, "w"));
    assert_eq!(again.element("n_averaged"), Some(Element::I64));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn tensors_beyond_their_storage_are_refused() {
    for (offset, shape, strides) in [
        (0, [2, 3], [3, 1]),
        (3, [1, 2], [2, 1]),
        (0, [2, 2], [i32::MAX, 1]),
        (-1, [1, 1], [1, 1]),
        (0, [i32::MAX, i32::MAX], [0, 0]),
    ] {
        let mut pickle = Pickler::new();
        pickle.dict(&[("w", &|p| {
            p.tensor("FloatStorage", "0", offset, &shape, &strides);
        })]);
        let file = torch_file(pickle.finish(), &[("0", f32s(&[0.0; 4]))]);
        let error = Checkpoint::from_bytes("bad.pt", file).unwrap_err();
        assert!(matches!(error, Error::Corrupt { .. }), "{error}");
    }
}

/// A checkpoint with a tensor `w` and an object that Python would make by calling `module.name` with `argument`.
fn calling(module: &str, name: &str, argument: &str) -> Vec<u8> {
    let mut pickle = Pickler::new();
    pickle.dict(&[
        ("other", &|p| {
            p.global(module, name);
            p.0.push(b'(');
            p.text(argument);
            p.0.extend(b"tR");
        }),
        ("w", &|p| p.tensor("FloatStorage", "0", 0, &[1], &[1])),
    ]);
    torch_file(pickle.finish(), &[("0", f32s(&[4.0]))])
}

#[test]
fn nothing_in_a_pickle_is_called() {
    let folder = tempfile::tempdir().unwrap();
    let trace = folder.path().join("was_here");
    let command = format!("touch {}", trace.display());
    let file = calling("training.tools", "run", &command);
    let checkpoint = Checkpoint::from_bytes("odd.pt", file).unwrap();
    assert_eq!(checkpoint.names().collect::<Vec<_>>(), ["w"]);
    assert!(!trace.exists());
}

#[test]
fn an_attack_on_python_is_named() {
    for (module, name) in [("posix", "system"), ("builtins", "eval")] {
        let error = Checkpoint::from_bytes("evil.pt", calling(module, name, "touch x"));
        let message = error.unwrap_err().to_string();
        let what = format!("{module}.{name}");
        assert!(
            message.contains("evil.pt") && message.contains(&what),
            "{message}"
        );
    }
}

#[test]
fn a_pickle_that_only_fills_the_memory_is_refused() {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let small = SimpleFileOptions::default().compression_method(CompressionMethod::Deflated);
    archive.start_file("archive/data.pkl", small).unwrap();
    archive.write_all(&[0x80, 2]).unwrap();
    archive.write_all(&vec![b')'; 20_000_000]).unwrap();
    let file = archive.finish().unwrap().into_inner();
    assert!(file.len() < 100_000);
    let message = Checkpoint::from_bytes("bomb.pt", file).unwrap_err();
    assert!(message.to_string().contains("instructions"), "{message}");
}

#[test]
fn tensors_that_are_many_times_their_file_are_not_written() {
    let mut pickle = Pickler::new();
    let names: Vec<String> = (0..20).map(|i| format!("w{i}")).collect();
    let whole = |p: &mut Pickler| p.tensor("FloatStorage", "0", 0, &[4096], &[1]);
    let items: Vec<(&str, Written<'_>)> = names
        .iter()
        .map(|name| (name.as_str(), &whole as Written<'_>))
        .collect();
    pickle.dict(&items);
    let file = torch_file(pickle.finish(), &[("0", f32s(&[1.0; 4096]))]);
    let checkpoint = Checkpoint::from_bytes("shared.pt", file).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let message = convert(&checkpoint, folder.path().join("out")).unwrap_err();
    assert!(message.to_string().contains("shared.pt"), "{message}");
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn modules_are_looked_into() {
    let mut pickle = Pickler::new();
    // As TorchScript and, within it, as Python pickles a module.
    pickle.global("__torch__.net", "Net");
    pickle.0.extend(b")\x81");
    pickle.dict(&[
        ("bias", &|p| p.tensor("FloatStorage", "0", 0, &[1], &[1])),
        ("training", &|p| p.0.push(0x89)),
        ("inner", &|p| {
            p.global("net", "Layer");
            p.0.extend(b")\x81");
            let weight = |p: &mut Pickler| p.tensor("FloatStorage", "0", 1, &[1], &[1]);
            p.dict(&[("_parameters", &|p| p.dict(&[("weight", &weight)]))]);
            p.0.push(b'b');
        }),
    ]);
    pickle.0.push(b'b');
    let file = torch_file(pickle.finish(), &[("0", f32s(&[4.0, 5.0]))]);
    let checkpoint = Checkpoint::from_bytes("net.jit", file).unwrap();
    assert_eq!(
        checkpoint.names().collect::<Vec<_>>(),
        ["bias", "inner.weight"]
    );
    assert_eq!(values(&checkpoint, "inner.weight"), [5.0]);
}

#[test]
fn values_that_are_not_finite_are_named() {
    let file = safetensors_of(&[("a.weight", Dtype::F32, &[2], f32s(&[1.0, f32::NAN]))]);
    let checkpoint = Checkpoint::from_bytes("test", file).unwrap();
    let error = checkpoint
        .tensor("a.weight", DType::F32)
        .unwrap_err()
        .to_string();
    assert!(error.contains("a.weight"), "{error}");
}

#[test]
fn other_files_are_told_from_checkpoints() {
    let torch_of_old = vec![0x80, 2, 0x8a, 10, 0x6c];
    let not_torch = torch_file(b"\x80\x02}.".to_vec(), &[]);
    for (bytes, expected) in [
        (torch_of_old, "1.6"),
        (b"hello".to_vec(), "not safetensors"),
        (not_torch, "no tensors"),
        (b"PK\x03\x04".to_vec(), "damaged"),
    ] {
        let error = Checkpoint::from_bytes("x", bytes).unwrap_err().to_string();
        assert!(error.contains(expected), "{error}");
    }
    let error = Checkpoint::open("/nonexistent/x.pt")
        .unwrap_err()
        .to_string();
    assert!(error.contains("/nonexistent/x.pt"), "{error}");
}

#[test]
fn a_part_that_is_not_there_is_named_with_those_that_are() {
    let file = safetensors_of(&[
        ("adapter.w", Dtype::F32, &[1], f32s(&[1.0])),
        ("pixel_decoder.w", Dtype::F32, &[1], f32s(&[2.0])),
    ]);
    let checkpoint = Checkpoint::from_bytes("test", file).unwrap();
    let part = checkpoint.require_part("pixel_decoder").unwrap();
    assert_eq!(values(&part, "w"), [2.0]);
    assert_eq!(
        values(&checkpoint.first_part(&["x", "adapter"]), "w"),
        [1.0]
    );
    let error = checkpoint.require_part("encoder").unwrap_err().to_string();
    assert!(error.contains("adapter, pixel_decoder"), "{error}");
}

#[test]
fn damage_is_found_by_the_archives_checksums() {
    let mut pickle = Pickler::new();
    pickle.dict(&[
        ("a", &|p| p.tensor("FloatStorage", "0", 0, &[8], &[1])),
        ("b", &|p| p.tensor("FloatStorage", "1", 0, &[8], &[1])),
    ]);
    let (a, b) = (f32s(&[1.25; 8]), f32s(&[-3.5; 8]));
    let file = torch_file(pickle.finish(), &[("0", a), ("1", b.clone())]);
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.safetensors");
    let at = file.windows(b.len()).position(|bytes| bytes == b).unwrap();
    for place in at..at + b.len() {
        let mut damaged = file.clone();
        damaged[place] ^= 1;
        let checkpoint = Checkpoint::from_bytes("damaged.pt", damaged).unwrap();
        // What is not damaged can still be read.
        assert_eq!(values(&checkpoint, "a"), [1.25; 8]);
        for error in [
            checkpoint.tensor("b", DType::F32).unwrap_err(),
            convert(&checkpoint, &out).unwrap_err(),
        ] {
            let message = error.to_string();
            for part in ["damaged.pt", "archive/data/1", "CRC-32"] {
                assert!(message.contains(part), "{message}");
            }
        }
        assert!(!out.exists());
    }

    // The pickle, too: here a name in it.
    let mut damaged = file.clone();
    let name = damaged
        .windows(9)
        .position(|bytes| bytes == b"X\x01\0\0\0b\x63to");
    damaged[name.unwrap() + 5] = b'c';
    let message = Checkpoint::from_bytes("damaged.pt", damaged).unwrap_err();
    assert!(
        message.to_string().contains("data.pkl is damaged"),
        "{message}"
    );
}

#[test]
fn no_damaged_byte_changes_a_value() {
    let mut pickle = Pickler::new();
    pickle.dict(&[
        ("a", &|p| p.tensor("FloatStorage", "0", 0, &[2], &[1])),
        ("b", &|p| p.tensor("FloatStorage", "1", 1, &[1], &[1])),
    ]);
    let storages = [("0", f32s(&[1.25, 2.0])), ("1", f32s(&[-3.5, 7.0]))];
    let file = torch_file(pickle.finish(), &storages);
    let read = |bytes: Vec<u8>| -> Result<Vec<(String, Vec<f32>)>> {
        let checkpoint = Checkpoint::from_bytes("damaged.pt", bytes)?;
        let read = |name: &str| {
            let tensor = checkpoint.tensor(name, DType::F32)?;
            Ok((name.to_owned(), tensor.flatten_all()?.to_vec1()?))
        };
        checkpoint.names().map(read).collect()
    };
    let whole = read(file.clone()).unwrap();
    let mut refused = 0;
    for place in 0..file.len() {
        for mask in [1, 0x10, 0x80, 0xff] {
            let mut damaged = file.clone();
            damaged[place] ^= mask;
            match read(damaged) {
                Ok(values) => assert_eq!(values, whole, "byte {place} ^ {mask:#x}"),
                Err(_) => refused += 1,
            }
        }
    }
    // Stamps, attributes and the headers in front of the members are of no effect.
    assert!(refused > file.len() * 2, "{refused} of {}", file.len() * 4);
}

#[test]
fn a_torch_file_without_checksums_is_read() {
    // As `torch.serialization.set_crc32_options(False)` has it: zero in every header of the central directory.
    let mut pickle = Pickler::new();
    pickle.dict(&[("a", &|p| p.tensor("FloatStorage", "0", 0, &[2], &[1]))]);
    let mut file = torch_file(pickle.finish(), &[("0", f32s(&[1.0, 2.0]))]);
    let headers: Vec<usize> = (0..file.len())
        .filter(|at| file[*at..].starts_with(b"PK\x01\x02"))
        .collect();
    assert_eq!(headers.len(), 3);
    for at in headers {
        file[at + 16..at + 20].fill(0);
    }
    let checkpoint = Checkpoint::from_bytes("unchecked.pt", file).unwrap();
    assert_eq!(values(&checkpoint, "a"), [1.0, 2.0]);
}
