//! Requests and keys of a player.

use super::{Player, Request};
use crate::{
    keyboard::Key,
    player::settings::{last_ns, start_ns},
};
use std::time::Duration;
use tracing::{info, warn};
use wm_msgs::rosbag2_interfaces::{
    Burst, BurstResponse, Empty, IsPausedResponse, PlayNext, PlayRequest, Rate, Success,
};
use wm_ros::{Call, answer};

/// Change of the rate for one key press.
const RATE_STEP: f64 = 0.1;

/// A request for single messages during a pause.
pub(super) struct BurstOrder {
    messages: u64,
    pub published: u64,
    client: BurstClient,
}

enum BurstClient {
    PlayNext(Call<PlayNext>),
    Burst(Call<Burst>),
    Key,
}

impl Player<'_> {
    pub(super) fn handle(&mut self, request: Request) {
        let now = self.epoch.elapsed();
        match request {
            Request::Pause(call) => {
                self.set_paused(true);
                answer(call, &Empty::default());
            }
            Request::Resume(call) => {
                self.set_paused(false);
                answer(call, &Empty::default());
            }
            Request::TogglePaused(call) => {
                self.set_paused(!self.playback.is_paused());
                answer(call, &Empty::default());
            }
            Request::IsPaused(call) => {
                let paused = self.playback.is_paused();
                answer(call, &IsPausedResponse { paused });
            }
            Request::GetRate(call) => {
                let rate = self.playback.rate();
                answer(call, &Rate { rate });
            }
            Request::SetRate(call) => {
                let success = self.set_rate(call.request.rate);
                answer(call, &Success { success });
            }
            Request::PlayNext(call) => self.burst(1, BurstClient::PlayNext(call)),
            Request::Burst(call) => {
                let messages = match call.request.num_messages {
                    0 => u64::MAX,
                    messages => messages,
                };
                self.burst(messages, BurstClient::Burst(call));
            }
            Request::Seek(call) => {
                let wanted_ns = call.request.time.checked_nanos().ok();
                // Times before 1970 are before every message: the playback jumps to the first one.
                let wanted_ns = wanted_ns.map(|ns| u64::try_from(ns).unwrap_or(0));
                let found_ns = wanted_ns.and_then(|ns| self.playback.seek(now, ns));
                if let Some(found_ns) = found_ns {
                    info!("resumed at {:.3}", found_ns as f64 / 1e9);
                    self.read_from(found_ns);
                }
                let success = found_ns.is_some();
                answer(call, &Success { success });
            }
            Request::Play(call) => {
                let success = self.play_again(&call.request);
                answer(call, &Success { success });
            }
            Request::Stop(call) => {
                self.playback.stop(now);
                info!("stopped");
                answer(call, &Empty::default());
            }
        }
    }

    pub(super) fn press(&mut self, key: Key) {
        let step = match key {
            Key::Space => return self.set_paused(!self.playback.is_paused()),
            Key::Right => return self.burst(1, BurstClient::Key),
            Key::Up => RATE_STEP,
            Key::Down => -RATE_STEP,
        };
        // Sums of tenths are not exact in binary.
        self.set_rate(((self.playback.rate() + step) * 1000.0).round() / 1000.0);
    }

    fn set_paused(&mut self, is_paused: bool) {
        let now = self.epoch.elapsed();
        if is_paused {
            self.playback.pause(now);
            info!(
                "paused at {:.3}",
                self.playback.position_ns(now) as f64 / 1e9
            );
        } else {
            self.playback.resume(now);
            info!("resumed");
        }
    }

    fn set_rate(&mut self, rate: f64) -> bool {
        let is_valid = self.playback.set_rate(self.epoch.elapsed(), rate);
        if is_valid {
            info!("rate {rate}");
        } else {
            warn!(
                "rate {rate} is out of range: the rate stays {}",
                self.playback.rate()
            );
        }
        is_valid
    }

    /// Starts the playback that `~/play` requests; returns false if it cannot. Limits that are zero or negative do not
    /// apply.
    fn play_again(&mut self, request: &PlayRequest) -> bool {
        let times = (
            request.start_offset.checked_nanos(),
            request.playback_duration.checked_nanos(),
            request.playback_until_timestamp.checked_nanos(),
        );
        let (Ok(offset_ns), Ok(duration_ns), Ok(until_ns)) = times else {
            warn!("a call of ~/play is refused: expected less than 1e9 ns in its times");
            return false;
        };
        let positive = |ns: i64| u64::try_from(ns).ok().filter(|ns| *ns > 0);
        // Without an offset, the playback begins at the start of the bag.
        let offset = Duration::from_nanos(positive(offset_ns).unwrap_or(0));
        let start_ns = start_ns(self.reader, offset);
        let duration = positive(duration_ns).map(Duration::from_nanos);
        let until_ns = positive(until_ns);
        let last_ns = last_ns(self.reader, start_ns, duration, until_ns);
        let begins = self.playback.play(self.epoch.elapsed(), start_ns, last_ns);
        if begins {
            self.read_from(start_ns);
        }
        begins
    }

    /// Publishes messages during the pause. The client gets its answer when they are published.
    fn burst(&mut self, messages: u64, client: BurstClient) {
        let order = BurstOrder {
            messages,
            published: 0,
            client,
        };
        let is_first = self.bursts.is_empty();
        self.bursts.push_back(order);
        if is_first && !self.playback.burst(messages) {
            warn!("pause the playback to play single messages");
        }
    }

    /// Answers the bursts that have ended, and starts the next one.
    pub(super) fn answer_bursts(&mut self) {
        while !self.playback.is_bursting()
            && let Some(order) = self.bursts.pop_front()
        {
            let actually_burst = order.published;
            match order.client {
                BurstClient::PlayNext(call) => {
                    let success = actually_burst > 0;
                    answer(call, &Success { success });
                }
                BurstClient::Burst(call) => answer(call, &BurstResponse { actually_burst }),
                BurstClient::Key => {}
            }
            if let Some(next) = self.bursts.front() {
                self.playback.burst(next.messages);
            }
        }
    }
}
