//! Model folders in 8 bits, with and without a calibration.

use super::*;
use crate::calibration::FILE as CALIBRATION;

fn origin() -> Origin {
    Origin {
        bags: vec!["test".to_owned()],
        frames: 2,
        strength: 0.5,
    }
}

fn in_format(folder: &TempDir, dtype: &str) -> DescribedFolder {
    let mut model = adapted();
    model["dtype"] = dtype.into();
    std::fs::write(folder.path().join(FILE), model.to_string()).unwrap();
    DescribedFolder::open(folder.path()).unwrap()
}

fn run(folder: &DescribedFolder) -> [Tensor; 3] {
    let decoder = folder.decoder(&Compute::default()).unwrap().unwrap();
    pass(
        &*folder.encoder(&Compute::default()).unwrap(),
        &folder.world_model(&Compute::default()).unwrap(),
        &*decoder,
    )
}

/// Calibrates the model in `folder` on what [`pass`] runs.
fn calibrate(folder: &TempDir) -> Calibration {
    let recorded = in_format(folder, "f32").recorded();
    run(&recorded);
    let calibration = recorded.calibration(origin()).unwrap();
    calibration.write(folder.path()).unwrap();
    calibration
}

#[test]
fn eight_bits_are_near_with_a_calibration_and_without() {
    let folder = folder(&adapted());
    let exact = run(&in_format(&folder, "f32"));
    let plain = run(&in_format(&folder, "int8"));
    calibrate(&folder);
    let smoothed = run(&in_format(&folder, "int8"));
    for (what, found) in [("plain", plain), ("smoothed", smoothed)] {
        for (part, (found, exact)) in ["latents", "predicted", "pictures"]
            .iter()
            .zip(found.iter().zip(&exact))
        {
            let norm = |x: &Tensor| -> f32 {
                let squares = x.sqr().unwrap().sum_all().unwrap();
                squares.to_scalar::<f32>().unwrap().sqrt()
            };
            let error = norm(&(found - exact).unwrap()) / norm(exact);
            println!("{what}, {part}: {error:.1e}");
            // Something was rounded, and not much.
            assert!(error > 1e-6 && error < 3e-2, "{what}, {part}: {error}");
        }
    }
}

#[test]
fn a_calibration_names_every_matrix_that_computed() {
    let folder = folder(&adapted());
    let calibration = calibrate(&folder);
    let matrices: Vec<_> = calibration.matrices().collect();
    // Of the encoder's layer q, k, v, out and two of the MLP; of the adapter's encoder as many and its projection; of the
    // transition two sub-blocks of five, the head's two, both of the time and that of the action.
    assert_eq!(
        matrices,
        [("adapter", 7), ("encoder", 6), ("transition", 15)]
    );
}

#[test]
fn a_calibration_is_part_of_what_latents_mean() {
    let folder = folder(&adapted());
    let hashes = || {
        let model = in_format(&folder, "int8");
        let world_model = model.world_model(&Compute::default()).unwrap();
        (model.space().unwrap().hash, world_model.hash)
    };
    let (space, model) = hashes();
    let f32_space = in_format(&folder, "f32").space().unwrap().hash;
    assert_ne!(space, f32_space);
    calibrate(&folder);
    let (calibrated_space, calibrated_model) = hashes();
    assert_ne!(calibrated_space, space);
    assert_ne!(calibrated_model, model);
    assert_eq!(hashes().0, calibrated_space);
    // It is for int8 only.
    assert_eq!(in_format(&folder, "f32").space().unwrap().hash, f32_space);
}

#[test]
fn a_calibration_of_other_weights_is_refused() {
    let folder = folder(&adapted());
    calibrate(&folder);
    std::fs::remove_file(folder.path().join("encoder.safetensors")).unwrap();
    write_random_weights(folder.path(), 8).unwrap();
    in_format(&folder, "f32");
    let mut model = adapted();
    model["dtype"] = "int8".into();
    std::fs::write(folder.path().join(FILE), model.to_string()).unwrap();
    let error = DescribedFolder::open(folder.path()).unwrap_err();
    assert!(
        matches!(
            &error,
            Error::Calibration {
                part: "encoder",
                ..
            }
        ),
        "{error}"
    );
    std::fs::remove_file(folder.path().join(CALIBRATION)).unwrap();
    in_format(&folder, "int8");
}

#[test]
fn tensors_have_no_eight_bits() {
    let folder = folder(&adapted());
    let plain = Compute::on_cpu(Kernels::Candle);
    let error = in_format(&folder, "int8").encoder(&plain).err().unwrap();
    assert!(error.to_string().contains("int8"), "{error}");
}

#[test]
fn what_was_trained_in_f32_predicts_in_other_formats() {
    let folder = folder(&adapted());
    let trained_on = in_format(&folder, "f32").space().unwrap();
    for dtype in ["f32", "bf16", "int8"] {
        let model = in_format(&folder, dtype);
        let known = model.space_of_training(&trained_on).unwrap();
        assert_eq!(known.hash, trained_on.hash, "{dtype}");
        let other = LatentSpace {
            hash: "another".to_owned(),
            ..trained_on.clone()
        };
        let known = model.space_of_training(&other).unwrap();
        assert_eq!(known.hash, model.space().unwrap().hash, "{dtype}");
    }
}
