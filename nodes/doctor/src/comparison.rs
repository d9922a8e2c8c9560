//! Compares the pictures of a live topic with each other.

use std::{
    sync::mpsc::{Receiver, SyncSender, sync_channel},
    thread::{JoinHandle, spawn},
};
use wm_audit::Pictures;
use wm_camera::{camera_frame::CameraFrame, signature::Signature};

/// The most pictures that wait for decoding.
const WAITING: usize = 16;
/// The most signatures for comparing motion with actions: a minute at 30 Hz, 6 MB.
const MOST_SIGNATURES: usize = 2_000;

#[derive(Clone, Debug, Default)]
pub struct Comparison {
    /// Each picture compared with its predecessor.
    pub pictures: Pictures,
    /// Stamp \[ns\] and signature of each picture.
    pub signatures: Vec<(i64, Signature)>,
    /// Pictures that arrived faster than they were decoded.
    pub skipped: u64,
}

/// Decodes and compares pictures on a separate thread while messages arrive.
pub(crate) struct Comparer {
    waiting: SyncSender<(CameraFrame, i64)>,
    thread: JoinHandle<Comparison>,
    /// Pictures received.
    count: u64,
}

impl Comparer {
    /// For the pictures of `topic`.
    pub(crate) fn new(topic: &str) -> Self {
        let (waiting, frames) = sync_channel(WAITING);
        let pictures = Pictures::new(topic);
        Self {
            waiting,
            thread: spawn(move || compare(&frames, pictures)),
            count: 0,
        }
    }

    /// Takes a picture; skips it if too many wait.
    pub(crate) fn take(&mut self, frame: CameraFrame, received_ns: i64) {
        self.count += 1;
        // skipped pictures are counted at the end
        let _ = self.waiting.try_send((frame, received_ns));
    }

    /// Waits for the last picture.
    pub(crate) fn finish(self) -> Comparison {
        drop(self.waiting);
        // a thread that panicked has compared none
        let comparison = self.thread.join().unwrap_or_default();
        Comparison {
            skipped: self.count - comparison.pictures.count().min(self.count),
            ..comparison
        }
    }
}

fn compare(frames: &Receiver<(CameraFrame, i64)>, pictures: Pictures) -> Comparison {
    let mut comparison = Comparison {
        pictures,
        ..Comparison::default()
    };
    for (frame, received_ns) in frames {
        // another check reports missing and malformed stamps
        let stamp_ns = frame.header().stamp.checked_nanos().unwrap_or(0);
        let at_ns = if stamp_ns > 0 { stamp_ns } else { received_ns };
        let signature = frame.decode().ok().map(|picture| Signature::of(&picture));
        if let Some(signature) = signature
            .clone()
            .filter(|_| comparison.signatures.len() < MOST_SIGNATURES)
        {
            comparison.signatures.push((at_ns, signature));
        }
        comparison
            .pictures
            .push(at_ns, frame.fingerprint(), frame.size(), signature);
    }
    comparison
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_msgs::{builtin_interfaces::Time, sensor_msgs::Image, std_msgs::Header};

    #[test]
    fn every_picture_is_compared_or_counted() {
        let mut comparer = Comparer::new("/camera");
        for index in 0..100_i64 {
            let image = Image {
                header: Header {
                    stamp: Time::from_nanos(1_000_000_000 + index * 33_000_000),
                    frame_id: String::new(),
                },
                height: 2,
                width: 2,
                encoding: "rgb8".into(),
                step: 6,
                data: vec![(index / 2) as u8; 12],
                ..Image::default()
            };
            comparer.take(CameraFrame::Raw(image), 0);
        }
        let comparison = comparer.finish();
        assert_eq!(comparison.pictures.count() + comparison.skipped, 100);
        assert_eq!(
            comparison.signatures.len() as u64,
            comparison.pictures.count()
        );
    }
}
