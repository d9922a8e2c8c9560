//! The largest response that rustdds may send. rustdds 0.15.1 corrupts the inline QoS of fragments (it writes a byte
//! too many in front). Only responses have inline QoS, so no client receives a fragmented response. [`super::wire`]
//! sends these.

use std::{fs, path::Path};

/// Bytes of an MTU that rustdds 0.15.1 reserves: 48 for headers, 32 for a heartbeat, 48 for the submessage, and the
/// header of the payload.
const OVERHEAD: usize = 48 + 32 + 48 + 4;
/// If the system does not list the MTUs.
const ETHERNET_MTU: usize = 1500;
/// The limit of UDP.
const LOOPBACK_MTU: usize = 65_500;
/// From `linux/if.h`.
const IFF_UP: u32 = 1;
const IFF_LOOPBACK: u32 = 8;

/// The largest response that rustdds sends unfragmented through any interface \[byte\].
pub(in crate::dds) fn largest_answer() -> usize {
    smallest_mtu(Path::new("/sys/class/net")) - OVERHEAD
}

/// The largest response that rustdds sends unfragmented on loopback \[byte\].
pub(in crate::dds) const LARGEST_ON_LOOPBACK: usize = LOOPBACK_MTU - OVERHEAD;

fn smallest_mtu(interfaces: &Path) -> usize {
    let Ok(entries) = fs::read_dir(interfaces) else {
        return ETHERNET_MTU;
    };
    let mtu = |entry: fs::DirEntry| -> Option<usize> {
        let read = |name| fs::read_to_string(entry.path().join(name)).ok();
        let flags = read("flags")?;
        let flags = u32::from_str_radix(flags.trim().strip_prefix("0x")?, 16).ok()?;
        let is_used = flags & IFF_UP != 0 && flags & IFF_LOOPBACK == 0;
        is_used.then(|| read("mtu")?.trim().parse().ok())?
    };
    let smallest = entries.filter_map(Result::ok).filter_map(mtu).min();
    // without another interface, only loopback is used
    smallest.unwrap_or(LOOPBACK_MTU).clamp(576, LOOPBACK_MTU)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn smallest_mtu_of_active_interfaces_counts() {
        let folder = tempfile::tempdir().unwrap();
        let add = |name: &str, flags: &str, mtu: &str| {
            let path = folder.path().join(name);
            fs::create_dir(&path).unwrap();
            fs::write(path.join("flags"), flags).unwrap();
            fs::write(path.join("mtu"), mtu).unwrap();
        };
        add("lo", "0x9\n", "65536\n");
        assert_eq!(smallest_mtu(folder.path()), LOOPBACK_MTU);
        add("down", "0x1002\n", "500\n");
        add("eth0", "0x1003\n", "1400\n");
        add("eth1", "0x1003\n", "9000\n");
        assert_eq!(smallest_mtu(folder.path()), 1400);
        assert_eq!(smallest_mtu(Path::new("/no/such")), ETHERNET_MTU);
    }
}
