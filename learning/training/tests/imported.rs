//! Real episodes of Bridge V2 and DROID, imported and prepared, from the directory in the environment variable
//! WM_SHARED_DATA (with `bridge_v2/` and `droid/`); they are not part of the repository.

use wm_dataset::{Data, DataOptions};
use wm_import::{ImportOptions, import_bridge, import_droid};

use crate::folder::shared;

#[test]
fn bridge_episodes_are_prepared() {
    let Some(source) = shared("bridge_v2") else {
        return;
    };
    let scratch = tempfile::tempdir().unwrap();
    let bags = scratch.path().join("bags");
    let made = import_bridge(&source, &bags, &ImportOptions::default())
        .unwrap()
        .bags;
    let options = DataOptions::default();
    let cache = scratch.path().join("cache");
    let data = Data::open(&[bags], (128, 128), &cache, &options).unwrap();
    let validation = data.validation.unwrap();
    let count = data.training.episodes().len() + validation.episodes().len();
    assert_eq!(count, made.len());
    // A WidowX moves less than 5 cm in 0.2 s, but does move.
    let action = data.training.statistics().unwrap().action;
    assert!(action.max[0] < 0.05 && action.min[0] > -0.05, "{action:?}");
    assert!(action.std[0] > 1e-3, "{action:?}");
}

#[test]
fn droid_episodes_are_prepared_with_three_cameras() {
    let Some(source) = shared("droid") else {
        return;
    };
    let scratch = tempfile::tempdir().unwrap();
    let bags = scratch.path().join("bags");
    let options = ImportOptions {
        episodes: Some(3),
        ..ImportOptions::default()
    };
    let made = import_droid(&source, &bags, &options).unwrap().bags;
    let reader = wm_bag::BagReader::open(made.first().unwrap()).unwrap();
    let topics = reader.topics().iter().map(|topic| topic.name.to_string());
    let cameras: Vec<String> = topics.filter(|name| name.contains("image_raw")).collect();
    assert_eq!(cameras.len(), 3);
    let options = DataOptions {
        cameras,
        validation: Some(0.0),
        ..DataOptions::default()
    };
    let cache = scratch.path().join("cache");
    let data = Data::open(&[bags], (64, 3 * 96), &cache, &options).unwrap();
    let training = data.training;
    assert_eq!((training.views(), training.size()), (3, (64, 288)));
    assert_eq!(training.episodes().len(), made.len());
    for episode in training.episodes() {
        assert!(episode.frame_count > 10 && episode.success.is_some());
        assert!(
            episode
                .instruction
                .as_ref()
                .is_some_and(|text| !text.is_empty())
        );
        let whole = episode.actions.iter().flatten();
        assert!(whole.copied().all(f32::is_finite));
    }
}
