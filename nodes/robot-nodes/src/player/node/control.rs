//! How a player answers calls and keys.

use super::{Player, command::Command};
use crate::{
    keyboard::Key,
    player::settings::{last_ns, start_ns},
};
use std::time::Duration;
use tracing::{info, warn};
use wm_msgs::rosbag2_interfaces::{
    Burst, BurstResponse, Empty, IsPausedResponse, PlayNext, PlayRequest, Rate, Success,
};
use wm_ros::Call;
use wm_ros::calls::answer;

/// What a key changes the rate by.
const RATE_STEP: f64 = 0.1;

/// Messages that were requested one by one while the playback is paused.
pub(super) struct Asked {
    messages: u64,
    pub published: u64,
    by: Asker,
}

enum Asker {
    PlayNext(Call<PlayNext>),
    Burst(Call<Burst>),
    Key,
}

impl Player {
    pub(super) fn obey(&mut self, command: Command) {
        let now = self.epoch.elapsed();
        match command {
            Command::Pause(call) => {
                self.set_paused(true);
                answer(call, &Empty::default());
            }
            Command::Resume(call) => {
                self.set_paused(false);
                answer(call, &Empty::default());
            }
            Command::TogglePaused(call) => {
                self.set_paused(!self.playback.is_paused());
                answer(call, &Empty::default());
            }
            Command::IsPaused(call) => {
                let paused = self.playback.is_paused();
                answer(call, &IsPausedResponse { paused });
            }
            Command::GetRate(call) => {
                let rate = self.playback.rate();
                answer(call, &Rate { rate });
            }
            Command::SetRate(call) => {
                let success = self.set_rate(call.request.rate);
                answer(call, &Success { success });
            }
            Command::PlayNext(call) => self.ask(1, Asker::PlayNext(call)),
            Command::Burst(call) => {
                let messages = match call.request.num_messages {
                    0 => u64::MAX,
                    messages => messages,
                };
                self.ask(messages, Asker::Burst(call));
            }
            Command::Seek(call) => {
                let wanted_ns = call.request.time.checked_nanos().ok();
                // A time before 1970 is that of the first message.
                let wanted_ns = wanted_ns.map(|ns| u64::try_from(ns).unwrap_or(0));
                let found_ns = wanted_ns.and_then(|ns| self.playback.seek(now, ns));
                if let Some(found_ns) = found_ns {
                    info!("resumed at {:.3}", found_ns as f64 / 1e9);
                    self.read_from(found_ns);
                }
                let success = found_ns.is_some();
                answer(call, &Success { success });
            }
            Command::Play(call) => {
                let success = self.play_again(&call.request);
                answer(call, &Success { success });
            }
            Command::Stop(call) => {
                self.playback.stop(now);
                info!("stopped");
                answer(call, &Empty::default());
            }
            Command::Key(Key::Space) => self.set_paused(!self.playback.is_paused()),
            Command::Key(Key::Right) => self.ask(1, Asker::Key),
            Command::Key(key @ (Key::Up | Key::Down)) => {
                let step = if key == Key::Up {
                    RATE_STEP
                } else {
                    -RATE_STEP
                };
                // tenths cannot be added exactly
                self.set_rate(((self.playback.rate() + step) * 1000.0).round() / 1000.0);
            }
        }
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

    /// Begins the playback that `~/play` requests; false if it cannot. Limits that are not positive are ignored: without any,
    /// everything is played.
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
        let offset = Duration::from_nanos(positive(offset_ns).unwrap_or(0));
        let start_ns = start_ns(&self.reader, offset);
        let duration = positive(duration_ns).map(Duration::from_nanos);
        let until_ns = positive(until_ns);
        let last_ns = last_ns(&self.reader, start_ns, duration, until_ns);
        let begins = self.playback.play(self.epoch.elapsed(), start_ns, last_ns);
        if begins {
            self.read_from(start_ns);
        }
        begins
    }

    /// Publishes messages although it is paused; answers when that is done.
    fn ask(&mut self, messages: u64, by: Asker) {
        let asked = Asked {
            messages,
            published: 0,
            by,
        };
        let is_first = self.asked.is_empty();
        self.asked.push_back(asked);
        if is_first && !self.playback.burst(messages) {
            warn!("pause the playback to play single messages");
        }
    }

    /// Answers whose messages are published, or cannot be, and turns to the next.
    pub(super) fn answer_who_asked(&mut self) {
        while !self.playback.is_bursting()
            && let Some(asked) = self.asked.pop_front()
        {
            let actually_burst = asked.published;
            match asked.by {
                Asker::PlayNext(call) => {
                    let success = actually_burst > 0;
                    answer(call, &Success { success });
                }
                Asker::Burst(call) => answer(call, &BurstResponse { actually_burst }),
                Asker::Key => {}
            }
            if let Some(next) = self.asked.front() {
                self.playback.burst(next.messages);
            }
        }
    }
}
