#![allow(clippy::unwrap_used)]

use candle_core::Tensor;
use image::{Rgb, RgbImage};
use wm_camera::image_message::encode_image;
use wm_model::{Encoder, LatentSpace};
use wm_msgs::std_msgs::Header;
use wm_wire::latent_message::LatentDtype;

use super::*;
use crate::{
    encoder::EncoderStep,
    test_world::{latent, stamp},
};

/// The mean brightness of a picture, times a factor.
struct Brightness(LatentSpace, f64);

impl Encoder for Brightness {
    fn space(&self) -> &LatentSpace {
        &self.0
    }

    fn input_size(&self) -> (usize, usize) {
        (8, 8)
    }

    fn encode(&self, images: &Tensor) -> wm_model::Result<Tensor> {
        Ok((images.mean_all()?.reshape((1, 1, 1, 1))? * self.1)?)
    }
}

fn goals_of(factor: f64, is_kept: bool) -> Goals {
    let space = LatentSpace {
        name: "brightness".into(),
        hash: factor.to_string(),
        height: 1,
        width: 1,
        channels: 1,
    };
    let encoder = EncoderStep::new(Box::new(Brightness(space, factor)), LatentDtype::F32);
    let pool = Pool::foreground("goals").unwrap();
    Goals::new(GoalReader::new(encoder), &pool, is_kept)
}

/// A white picture.
fn picture() -> Source {
    let white = RgbImage::from_pixel(8, 8, Rgb([255; 3]));
    let header = Header {
        stamp: stamp(3),
        ..Header::default()
    };
    Source::Picture(CameraFrame::Raw(encode_image(&white, header)))
}

async fn read(goals: &mut Goals) -> Goal {
    goals.work.finished().await.unwrap().unwrap()
}

#[tokio::test]
async fn another_model_reads_the_picture_of_the_goal_again() {
    let mut before = goals_of(1.0, true);
    assert!(before.take(picture()));
    let first = read(&mut before).await;
    let mut after = goals_of(0.5, true);
    assert!(after.continue_from(&before, true, false));
    let again = read(&mut after).await;
    assert_eq!((again.stamp, first.stamp), (stamp(3), stamp(3)));
    let value = |goal: &Goal| {
        goal.latents
            .first()
            .and_then(|latent| latent.first())
            .copied()
    };
    assert_eq!((value(&first), value(&again)), (Some(1.0), Some(0.5)));
    // And a third one.
    let mut third = goals_of(0.25, true);
    assert!(third.continue_from(&after, true, false));
    assert_eq!(value(&read(&mut third).await), Some(0.25));
}

#[tokio::test]
async fn goal_is_read_again_only_if_it_is_needed() {
    let mut before = goals_of(1.0, true);
    assert!(before.take(picture()));
    // It is still being read.
    let mut after = goals_of(1.0, true);
    assert!(after.continue_from(&before, false, true));
    assert!(after.work.is_running());
    read(&mut before).await;
    for (is_set, is_same_space) in [(true, true), (false, false)] {
        let mut after = goals_of(1.0, true);
        assert!(after.continue_from(&before, is_set, is_same_space));
        assert!(!after.work.is_running());
    }
}

#[tokio::test]
async fn latents_of_another_space_are_no_goal_any_more() {
    let mut before = goals_of(1.0, true);
    let message = GoalMessage {
        latents: vec![latent(0)],
        ..GoalMessage::default()
    };
    assert!(before.take(Source::Message(message)));
    before.work.finished().await.unwrap().unwrap_err();
    let mut after = goals_of(0.5, true);
    assert!(!after.continue_from(&before, true, false));
    assert!(!after.work.is_running());
}

#[tokio::test]
async fn node_that_stays_with_its_model_keeps_no_goal() {
    let mut goals = goals_of(1.0, false);
    assert!(goals.take(picture()));
    read(&mut goals).await;
    assert!(goals.newest.is_none());
}
