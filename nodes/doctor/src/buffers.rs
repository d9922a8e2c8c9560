//! The kernel's receive buffers.

use crate::{DoctorError, Finding, Survey, system_file::read};
use std::io;

const CHECK: &str = "buffers";
/// The value that docs/networking.md recommends \[byte\].
const WANTED: u64 = 4 << 20;
const FIX: &str = "sudo sysctl -w net.core.rmem_max=4194304 net.core.rmem_default=4194304, and the same two lines in \
                    /etc/sysctl.d/wm.conf";

/// The receive buffers of sockets.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Buffers {
    /// `net.core.rmem_default`, the buffer of the DDS library's sockets \[byte\].
    pub default: u64,
    /// `net.core.rmem_max` \[byte\].
    pub most: u64,
    /// Datagrams dropped because of a full buffer since the start of the system.
    pub dropped: u64,
}

impl Buffers {
    pub(crate) fn look() -> Result<Self, DoctorError> {
        let size = |name: &str| -> Result<u64, DoctorError> {
            let file = format!("/proc/sys/net/core/{name}");
            let text = read(&file)?;
            text.trim().parse().map_err(|error| DoctorError::System {
                file: file.into(),
                source: io::Error::new(io::ErrorKind::InvalidData, error),
            })
        };
        Ok(Self {
            default: size("rmem_default")?,
            most: size("rmem_max")?,
            dropped: dropped_of(&read("/proc/net/snmp")?),
        })
    }

    /// Datagrams dropped since `self` was read.
    fn dropped_since(&self) -> u64 {
        Self::look().map_or(0, |now| now.dropped.saturating_sub(self.dropped))
    }
}

/// `RcvbufErrors` of UDP, from the text of `/proc/net/snmp`: a line of names, then a line of values.
fn dropped_of(text: &str) -> u64 {
    let mut lines = text.lines().filter_map(|line| line.strip_prefix("Udp:"));
    let (Some(names), Some(values)) = (lines.next(), lines.next()) else {
        return 0;
    };
    let mut pairs = names.split_whitespace().zip(values.split_whitespace());
    let found = pairs.find(|(name, _)| *name == "RcvbufErrors");
    found.and_then(|(_, value)| value.parse().ok()).unwrap_or(0)
}

/// The findings after listening.
pub(crate) fn check(buffers: &Buffers, survey: &Survey) -> Vec<Finding> {
    judge(buffers, buffers.dropped_since(), largest(survey))
}

fn largest(survey: &Survey) -> u64 {
    let largest = survey.streams().map(|stream| stream.largest).max();
    largest.map_or(0, |bytes| bytes as u64)
}

fn judge(buffers: &Buffers, dropped: u64, largest: u64) -> Vec<Finding> {
    let Buffers { default, most, .. } = *buffers;
    let sizes = format!(
        "receive buffers of {} KiB, at most {} KiB",
        default / 1024,
        most / 1024
    );
    if dropped > 0 {
        return vec![
            Finding::warning(CHECK, format!("{dropped} datagrams were dropped while listening, because a buffer was full ({sizes})"))
                .because("a message that lacks one datagram is lost, or sent again if it is reliable")
                .fix(FIX),
        ];
    }
    let is_small = default < WANTED || most < WANTED;
    vec![match is_small {
        true if largest > default => Finding::warning(CHECK, format!("messages of {} KiB, and {sizes}", largest / 1024))
            .because("drivers of other DDS implementations send a picture in one burst, which has to fit; nodes of wm do not")
            .fix(FIX),
        true => Finding::note(CHECK, sizes)
            .because("enough for the received messages; raw pictures of other DDS implementations may not fit")
            .fix(FIX),
        false => Finding::ok(CHECK, sizes),
    }]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Level;

    #[test]
    fn udp_drops_are_read_by_column_name() {
        let text = "Tcp: A\nTcp: 1\nUdp: InDatagrams RcvbufErrors InErrors\nUdp: 100 7 9\n";
        assert_eq!(dropped_of(text), 7);
        assert_eq!((dropped_of("Udp: RcvbufErrors\n"), dropped_of("")), (0, 0));
    }

    #[test]
    fn buffers_smaller_than_messages_are_a_warning() {
        let linux = Buffers {
            default: 212_992,
            most: 212_992,
            dropped: 0,
        };
        let large = Buffers {
            default: WANTED,
            most: WANTED,
            dropped: 0,
        };
        let level = |buffers: &Buffers, dropped, largest| judge(buffers, dropped, largest)[0].level;
        assert_eq!(level(&linux, 0, 50_000), Level::Note);
        assert_eq!(level(&linux, 0, 921_600), Level::Warning);
        assert_eq!(level(&large, 0, 921_600), Level::Ok);
        assert_eq!(level(&large, 3, 0), Level::Warning);
        assert!(
            judge(&linux, 0, 921_600)[0]
                .fix
                .as_deref()
                .unwrap()
                .contains("rmem_default=4194304")
        );
    }
}
