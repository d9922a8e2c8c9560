//! Writes the binary seeds of the corpus: `cargo run --release -p wm_fuzz --example seeds`.

#![allow(clippy::unwrap_used, reason = "a developer's tool")]

use std::{collections::BTreeMap, fs, path::Path};
use wm_bag::{BagWriter, Compression, WriterOptions, type_schema};
use wm_msgs::{
    builtin_interfaces::Time,
    cdr,
    sensor_msgs::{CompressedImage, Image},
    std_msgs::{self, Header},
    wm_msgs::{Action, ActionChunk, Latent, LatentSpace},
};

fn main() {
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    let seeds = [
        messages(),
        pictures(),
        parts(),
        requests(),
        bags(),
        tensors(),
    ];
    for (name, bytes) in seeds.into_iter().flatten() {
        let path = corpus.join(name);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, bytes).unwrap();
    }
}

type Seeds = Vec<(&'static str, Vec<u8>)>;

fn header() -> Header {
    Header {
        stamp: Time {
            sec: 1_700_000_000,
            nanosec: 5,
        },
        frame_id: "camera".to_owned(),
    }
}

fn messages() -> Seeds {
    let action = || Action {
        header: header(),
        values: vec![0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0],
    };
    let chunk = ActionChunk {
        header: header(),
        actions: vec![action(), action()],
        ..Default::default()
    };
    let latent = Latent {
        header: header(),
        space: LatentSpace {
            name: "tiny".to_owned(),
            hash: "0123456789abcdef".to_owned(),
        },
        height: 1,
        width: 2,
        channels: 3,
        dtype: Latent::BF16,
        epoch: 7,
        change: 0.25,
        frozen: true,
        data: vec![0; 12],
    };
    vec![
        ("message/action", cdr::to_bytes(&action()).unwrap()),
        ("message/action_chunk", cdr::to_bytes(&chunk).unwrap()),
        ("message/latent", cdr::to_bytes(&latent).unwrap()),
        (
            "message/text",
            cdr::to_bytes(&std_msgs::String {
                data: "text".to_owned(),
            })
            .unwrap(),
        ),
    ]
}

const PROGRESSIVE: &[u8] =
    include_bytes!("../../bags/camera/fixtures/jpeg/420-progressive-restart=420.jpg");
const SCANS: &[u8] = include_bytes!("../../bags/camera/fixtures/jpeg/422-scans-restart=422.jpg");

fn pictures() -> Seeds {
    let raw = |encoding: &str, step, len| Image {
        header: header(),
        height: 2,
        width: 3,
        encoding: encoding.to_owned(),
        is_bigendian: 0,
        step,
        data: vec![127; len],
    };
    let pixels = image::RgbImage::from_pixel(8, 8, image::Rgb([200, 100, 50]));
    let compressed = |format: &str, as_format| {
        let mut data = std::io::Cursor::new(Vec::new());
        pixels.write_to(&mut data, as_format).unwrap();
        let message = CompressedImage {
            header: header(),
            format: format.to_owned(),
            data: data.into_inner(),
        };
        cdr::to_bytes(&message).unwrap()
    };
    vec![
        ("picture/rgb8", cdr::to_bytes(&raw("rgb8", 9, 18)).unwrap()),
        (
            "picture/bgra8",
            cdr::to_bytes(&raw("bgra8", 12, 24)).unwrap(),
        ),
        ("picture/mono8", cdr::to_bytes(&raw("mono8", 3, 6)).unwrap()),
        (
            "picture/yuv422",
            cdr::to_bytes(&raw("yuv422_yuy2", 6, 12)).unwrap(),
        ),
        (
            "picture/jpeg",
            compressed("rgb8; jpeg compressed bgr8", image::ImageFormat::Jpeg),
        ),
        ("picture/png", compressed("png", image::ImageFormat::Png)),
        ("picture/progressive.jpg", PROGRESSIVE.to_vec()),
        ("picture/scans.jpg", SCANS.to_vec()),
    ]
}

/// A part of each kind, with the fields in wire order.
fn parts() -> Seeds {
    let part = |kind: u8| {
        let fields = ([7_u8; 16], 3_i64, 5_u32, 1_i64, 0_i64, 1_i64, 0_u32);
        cdr::to_bytes(&(kind, fields, b"hello".to_vec())).unwrap()
    };
    vec![
        ("part/0", part(0)),
        ("part/1", part(1)),
        ("part/2", part(2)),
        ("part/3", part(3)),
        ("part/4", part(4)),
    ]
}

fn requests() -> Seeds {
    let names = vec!["use_sim_time".to_owned(), "model".to_owned()];
    let levels = vec![("wm.encoder".to_owned(), 10_u32)];
    vec![
        ("request/names", cdr::to_bytes(&names).unwrap()),
        ("request/list", cdr::to_bytes(&(names, 0_u64)).unwrap()),
        ("request/levels", cdr::to_bytes(&levels).unwrap()),
    ]
}

fn bags() -> Seeds {
    let bag = |messages: u64, chunk_size, compression| {
        let scratch = tempfile::tempdir().unwrap();
        let dir = scratch.path().join("bag");
        let options = WriterOptions {
            chunk_size,
            compression,
            ..WriterOptions::default()
        };
        let mut writer = BagWriter::create(&dir, options).unwrap();
        let schema = type_schema::<std_msgs::String>();
        for number in 0..messages {
            let data = cdr::to_bytes(&std_msgs::String {
                data: format!("message {number}"),
            })
            .unwrap();
            let time_ns = 1_700_000_000_000_000_000 + number;
            writer
                .write_raw("/told", "std_msgs/msg/String", &schema, time_ns, &data)
                .unwrap();
        }
        writer.finish().unwrap();
        let mut files = fs::read_dir(&dir)
            .unwrap()
            .map(|entry| entry.unwrap().path());
        let file = files
            .find(|path| path.extension().is_some_and(|e| e == "mcap"))
            .unwrap();
        (
            fs::read(file).unwrap(),
            fs::read(dir.join("metadata.yaml")).unwrap(),
        )
    };
    let (one, metadata) = bag(1, 1000, Compression::None);
    let (lz4, _) = bag(12, 200, Compression::Lz4);
    let (zstd, _) = bag(12, 200, Compression::Zstd);
    let cut = zstd[..zstd.len() * 2 / 3].to_vec();
    vec![
        ("bag/one_message.mcap", one.clone()),
        ("bag/lz4.mcap", lz4.clone()),
        ("bag/zstd.mcap", zstd.clone()),
        ("bag/cut.mcap", cut.clone()),
        ("recover/one_message.mcap", one),
        ("recover/lz4.mcap", lz4),
        ("recover/cut.mcap", cut),
        ("metadata/one_message.yaml", metadata),
    ]
}

fn tensors() -> Seeds {
    use safetensors::{Dtype, serialize, tensor::TensorView};
    let values = [1_f32, 2.0, 3.0, 4.0].map(f32::to_le_bytes).concat();
    let view = || TensorView::new(Dtype::F32, vec![2, 2], &values).unwrap();
    let tensors = BTreeMap::from([("model.head.weight", view()), ("ema.head.weight", view())]);
    let file = serialize(tensors, None).unwrap();
    vec![
        ("checkpoint/f32.safetensors", file.clone()),
        ("weights/f32.safetensors", file),
        ("checkpoint/f32.pt", wm_fuzz::torch_file(PICKLE)),
        ("pickle/one_tensor", PICKLE.to_vec()),
        ("pickle/protocol_4", b"\x80\x04\x95\x16\x00\x00\x00\x00\x00\x00\x00}\x94\x8c\x01a\x94K\x01J\xff\xff\xff\xff\x88\x87\x94s.".to_vec()),
    ]
}

/// The pickle of `torch.save({"weight": tensor})` with four floats in two rows.
const PICKLE: &[u8] = b"\x80\x02}q\x00X\x06\x00\x00\x00weightq\x01ctorch._utils\n_rebuild_tensor_v2\nq\x02((X\x07\x00\x00\x00\
storageq\x03ctorch\nFloatStorage\nq\x04X\x01\x00\x00\x000q\x05X\x03\x00\x00\x00cpuq\x06K\x04tq\x07QK\x00K\x02K\x02\x86q\x08K\x02K\
\x01\x86q\x09\x89ccollections\nOrderedDict\nq\x0a)Rq\x0btq\x0cRq\x0ds.";
