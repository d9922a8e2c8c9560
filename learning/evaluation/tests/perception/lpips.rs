//! LPIPS against the published package, if available: `WM_LPIPS_DIR` is a folder as `fixtures/lpips_package.py` writes it.

use std::path::Path;
use std::{env, fs};

use candle_core::Tensor;
use wm_model::image::preprocess;
use wm_zoo::lpips::Lpips;

#[test]
fn distances_match_the_published_package() {
    let Some(folder) = env::var_os("WM_LPIPS_DIR") else {
        println!(
            "skipped: WM_LPIPS_DIR names no folder with AlexNet and the distances of the package lpips"
        );
        return;
    };
    let folder = Path::new(&folder);
    let lpips = Lpips::open(
        &folder.join("alexnet.safetensors"),
        &folder.join("heads.safetensors"),
    )
    .unwrap();
    let expected = fs::read_to_string(folder.join("distances.json")).unwrap();
    let expected: Vec<f64> = serde_json::from_str(&expected).unwrap();
    assert_eq!(expected.len(), 10);
    let picture = |name: String| -> Tensor {
        let picture = image::open(folder.join(name)).unwrap().to_rgb8();
        let (width, height) = picture.dimensions();
        preprocess(&picture, (height as usize, width as usize)).unwrap()
    };
    for (number, expected) in expected.into_iter().enumerate() {
        let [a, b] = ["a", "b"].map(|name| picture(format!("{number}{name}.png")));
        let found = lpips.distance(&a, &b).unwrap();
        let found = f64::from(found.to_scalar::<f32>().unwrap());
        println!("pair {number}: {found:.6}, the package {expected:.6}");
        assert!(
            (found - expected).abs() < 1e-4,
            "pair {number}: {found} {expected}"
        );
    }
}
