use super::*;

fn file() -> Vec<u8> {
    let mut builder = WeightsBuilder::new();
    builder.values(
        "a.weight",
        &[2, 3],
        &[1., 2., 3., 4., 5., 6.],
        Precision::F32,
    );
    builder.values("b.bias", &[2], &[0.5, -2.0], Precision::F16);
    builder.metadata("config", r#"{"width":3}"#);
    builder.to_bytes()
}

fn open(bytes: Vec<u8>) -> Result<Weights> {
    Weights::from_bytes("test.safetensors", bytes)
}

#[test]
fn what_was_written_is_read() {
    let weights = open(file()).unwrap();
    assert_eq!(
        weights.values("a.weight", &[2, 3]).unwrap(),
        [1., 2., 3., 4., 5., 6.]
    );
    assert_eq!(weights.values("b.bias", &[2]).unwrap(), [0.5, -2.0]);
    let config: serde_json::Value = weights.json("config").unwrap();
    assert_eq!(config["width"], 3);
    weights.finish().unwrap();
}

#[test]
fn the_identity_covers_what_is_said_of_the_tensors() {
    let with = |config: &str| {
        let mut builder = WeightsBuilder::new();
        builder.values("a", &[1], &[1.0], Precision::F32);
        builder.metadata("config", config);
        open(builder.to_bytes()).unwrap()
    };
    let (narrow, wide) = (with(r#"{"width":3}"#), with(r#"{"width":4}"#));
    assert_eq!(narrow.sha256(), wide.sha256());
    let identity = |weights: &Weights| weights.identity(&["config"]).unwrap();
    assert_ne!(identity(&narrow), identity(&wide));
    assert_eq!(identity(&narrow), identity(&with(r#"{"width":3}"#)));
    assert!(narrow.identity(&["actions"]).is_err());
}

#[test]
fn the_same_content_gives_the_same_bytes() {
    assert_eq!(file(), file());
}

#[test]
fn a_missing_tensor_is_named() {
    let message = open(file())
        .unwrap()
        .tensor("c.weight", &[4])
        .unwrap_err()
        .to_string();
    assert_eq!(
        message,
        "test.safetensors: tensor `c.weight` of shape [4] is missing"
    );
}

#[test]
fn a_wrong_shape_is_named() {
    let message = open(file())
        .unwrap()
        .tensor("a.weight", &[3, 2])
        .unwrap_err()
        .to_string();
    assert_eq!(
        message,
        "test.safetensors: tensor `a.weight` has shape [2, 3], expected [3, 2]"
    );
}

#[test]
fn an_unexpected_tensor_is_named() {
    let weights = open(file()).unwrap();
    weights.tensor("a.weight", &[2, 3]).unwrap();
    let message = weights.finish().unwrap_err().to_string();
    assert_eq!(message, "test.safetensors: unexpected tensors: b.bias");
}

#[test]
fn a_flipped_bit_is_a_wrong_hash() {
    let mut bytes = file();
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
    let error = open(bytes).unwrap_err();
    assert!(
        matches!(&error, Error::WrongHash { expected, found, .. } if expected != found),
        "{error}"
    );
}

#[test]
fn truncated_and_foreign_bytes_are_corrupt() {
    let bytes = file();
    for end in [0, 4, 20, bytes.len() - 3] {
        let error = open(bytes[..end].to_vec()).unwrap_err();
        assert!(
            matches!(&error, Error::CorruptWeights { file, .. } if file == "test.safetensors"),
            "{end}: {error}"
        );
    }
    assert!(matches!(
        open(b"this is not a safetensors file".to_vec()),
        Err(Error::CorruptWeights { .. })
    ));
}

#[test]
fn a_value_that_is_not_finite_is_refused() {
    let mut builder = WeightsBuilder::new();
    builder.values("a", &[2], &[1.0, f32::NAN], Precision::F32);
    let error = open(builder.to_bytes())
        .unwrap()
        .values("a", &[2])
        .unwrap_err();
    assert!(matches!(error, Error::TensorNotFinite { name, .. } if name == "a"));
}

#[test]
fn a_missing_metadata_entry_is_named() {
    let message = open(file())
        .unwrap()
        .require_metadata("steps")
        .unwrap_err()
        .to_string();
    assert_eq!(message, "test.safetensors: metadata entry `steps`: missing");
}

#[test]
fn a_file_is_replaced_whole() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("deep/weights.safetensors");
    let mut builder = WeightsBuilder::new();
    builder.values("a", &[1], &[1.0], Precision::F32);
    builder.write(&path).unwrap();
    builder.values("a", &[1], &[2.0], Precision::F32);
    builder.write(&path).unwrap();
    let weights = Weights::open(&path).unwrap();
    assert_eq!(weights.values("a", &[1]).unwrap(), [2.0]);
    assert_eq!(
        std::fs::read_dir(path.parent().unwrap()).unwrap().count(),
        1
    );
}
