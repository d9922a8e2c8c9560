use image::{Rgb, RgbImage};

use super::*;

#[test]
fn without_networks_there_are_no_metrics() {
    let picture = RgbImage::from_pixel(8, 8, Rgb([1, 2, 3]));
    let pictures = [picture.clone(), picture.clone()];
    let pictures = RolloutPictures {
        observed: std::slice::from_ref(&picture),
        truth: &pictures,
        predicted: &pictures,
        reconstructed: &pictures,
    };
    let perception = Perception::open(&PerceptionArgs::default()).unwrap();
    assert_eq!(perception.description(), None);
    let found = perception.measure(&pictures).unwrap();
    assert!(found.is_empty());
    assert_eq!(serde_json::to_string(&found).unwrap(), "{}");
    assert_eq!(
        serde_json::from_str::<EpisodePerception>("{}").unwrap(),
        found
    );
}

#[test]
fn records_round_trip() {
    let mut found = EpisodePerception::default();
    found.keep(
        EpisodeFigure::TLpips,
        Ok::<_, String>(Values::of(vec![0.25])),
    );
    found.keep(EpisodeFigure::FlowScore, Err("too short"));
    let vectors = Vectors::of(&[vec![1.0, 2.0]]).unwrap();
    let of = BySource {
        truth: vectors.clone(),
        predicted: vectors.clone(),
        reconstructed: vectors,
    };
    found.features.insert(FeatureSpace::Fvd, of);
    let text = serde_json::to_string(&found).unwrap();
    assert!(text.contains(r#""t_lpips":{"predicted":[0.25]}"#), "{text}");
    assert!(text.contains(r#""flow_score":"too short""#), "{text}");
    assert_eq!(
        serde_json::from_str::<EpisodePerception>(&text).unwrap(),
        found
    );
}
