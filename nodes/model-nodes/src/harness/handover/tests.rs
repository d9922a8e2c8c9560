use wm_ros::PublisherId;

use super::*;
use crate::test_world::{latent_of, other_space, space, stamp};

/// Frame `index` in the other space.
fn message(index: i64) -> KeptMessage {
    KeptMessage::Latent(Received {
        message: Arc::new(latent_of(index, &other_space())),
        received: stamp(index),
        at: std::time::Instant::now(),
        publisher: PublisherId::default(),
    })
}

fn stamps(handover: &Handover) -> Vec<i64> {
    let kept = std::iter::from_fn(|| handover.latent());
    kept.map(|received| received.message.header.stamp.to_nanos())
        .collect()
}

#[test]
fn nothing_is_kept_without_a_change() {
    let handover = Handover::default();
    assert!(!handover.keep(message(0)));
    handover.begin();
    assert!(handover.keep(message(1)));
    // The model could not be loaded.
    assert_eq!(handover.end(Some(&space()), false), 1);
    assert!(!handover.keep(message(2)));
    assert!(stamps(&handover).is_empty());
}

#[test]
fn kept_latents_come_after_the_change_in_their_order() {
    let handover = Handover::default();
    handover.begin();
    for index in 0..3 {
        assert!(handover.keep(message(index)));
    }
    assert!(stamps(&handover).is_empty(), "the model is still loaded");
    assert_eq!(handover.end(Some(&other_space()), false), 0);
    let expected: Vec<i64> = (0..3).map(|index| stamp(index).to_nanos()).collect();
    assert_eq!(stamps(&handover), expected);
}

#[test]
fn newest_latents_are_kept_and_lost_ones_reported() {
    let handover = Handover::default();
    handover.begin();
    let count = 40;
    let kept = (0..count).filter(|index| handover.keep(message(*index)));
    assert_eq!(kept.count(), MOST_KEPT);
    handover.end(Some(&other_space()), false);
    let stamps = stamps(&handover);
    assert_eq!(stamps.len(), MOST_KEPT);
    assert_eq!(stamps.last(), Some(&stamp(count - 1).to_nanos()));
}

#[test]
fn latents_of_a_third_model_wait_for_it() {
    let handover = Handover::default();
    handover.begin();
    handover.keep(message(0));
    assert_eq!(handover.end(Some(&space()), true), 0);
    assert!(stamps(&handover).is_empty());
    assert_eq!(handover.end(Some(&other_space()), false), 0);
    assert_eq!(stamps(&handover), [stamp(0).to_nanos()]);
}

#[test]
fn only_another_space_delays_a_change() {
    let now = Instant::now();
    let (present, new) = (space(), other_space());
    let time = |new, makes_latents| ChangeTime::of(Some(&present), new, makes_latents, now);
    assert_eq!(time(Some(&present), false), ChangeTime::Now);
    assert_eq!(time(Some(&present), true), ChangeTime::Now);
    assert_eq!(time(None, false), ChangeTime::Now);
    let first = ChangeTime::FirstLatent(new.clone(), now + LONGEST_WAIT);
    assert_eq!(time(Some(&new), false), first);
    assert_eq!(time(Some(&new), true), ChangeTime::At(now + HEAD_START));
}

#[tokio::test]
async fn node_changes_at_the_first_latent_or_after_the_wait() {
    let handover = Handover::default();
    handover.begin();
    let in_time = |wait| ChangeTime::FirstLatent(other_space(), Instant::now() + wait);
    let short = in_time(Duration::from_millis(20));
    assert!(!handover.wait(&short).await, "no latent arrived");
    let long = in_time(Duration::from_secs(60));
    let (arrived, kept) = tokio::join!(handover.wait(&long), async {
        tokio::task::yield_now().await;
        handover.keep(message(0))
    });
    assert!(arrived && kept);
    assert!(handover.wait(&short).await, "it has arrived");
    let other = ChangeTime::FirstLatent(space(), Instant::now() + Duration::from_millis(20));
    assert!(!handover.wait(&other).await, "it is of another space");
}
