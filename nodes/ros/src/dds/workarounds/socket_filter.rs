//! Drops datagrams from other networks. rustdds 0.15.1 binds its sockets to every address of the host, and processes
//! everything that arrives. So a classic BPF program on each socket lets the kernel drop datagrams from interfaces that
//! were not requested. It needs no privilege.
//!
//! Datagrams from this host's own addresses pass on any interface: multicast of a neighbour process on Ethernet returns
//! by Ethernet. The kernel itself drops packets of other hosts with such a source.

use socket2::{SockFilter, SockRef, Type};
use std::{
    collections::BTreeSet,
    fs, io,
    net::{IpAddr, Ipv4Addr},
    os::fd::{BorrowedFd, RawFd},
};

/// Instructions of classic BPF (`linux/bpf_common.h`, `linux/filter.h`).
mod bpf {
    /// Load a word.
    pub(in crate::dds) const LOAD: u16 = 0x20;
    /// Jump where the accumulator equals the constant.
    pub(in crate::dds) const JUMP_EQUAL: u16 = 0x15;
    /// Bitwise and with the constant.
    pub(in crate::dds) const AND: u16 = 0x54;
    pub(in crate::dds) const RETURN: u16 = 0x06;
    /// The index of the receiving interface.
    pub(in crate::dds) const INTERFACE: u32 = 0xffff_f000 + 8;
    /// The source address in the IPv4 header.
    pub(in crate::dds) const SOURCE: u32 = 0xfff0_0000 + 12;
    /// The whole packet.
    pub(in crate::dds) const ALL: u32 = u32::MAX;
}

/// The RTPS ports of a participant (DDSI-RTPS 2.5, 9.6.2.3).
pub(in crate::dds) struct Ports {
    domain: u16,
    participant: u16,
}

impl Ports {
    pub(in crate::dds) fn new(domain: u16, participant: u16) -> Self {
        Self {
            domain,
            participant,
        }
    }

    const fn base(&self) -> u16 {
        7400 + 250 * self.domain
    }

    /// Whether the ports exist.
    pub(in crate::dds) fn fit(&self) -> bool {
        let last = 7400 + 250 * u32::from(self.domain) + 11 + 2 * u32::from(self.participant);
        u16::try_from(last).is_ok()
    }

    /// The port for discovery.
    pub(in crate::dds) const fn discovery(&self) -> u16 {
        self.base() + 10 + 2 * self.participant
    }

    /// The port for samples, unless another program has it.
    pub(in crate::dds) const fn user(&self) -> u16 {
        self.base() + 11 + 2 * self.participant
    }

    fn all(&self) -> [u16; 4] {
        [self.base(), self.base() + 1, self.discovery(), self.user()]
    }
}

/// The UDP sockets of this process, by file descriptor.
pub(in crate::dds) fn sockets() -> io::Result<BTreeSet<RawFd>> {
    let mut found = BTreeSet::new();
    for entry in fs::read_dir("/proc/self/fd")? {
        let name = entry?.file_name();
        let fd = name.to_str().and_then(|name| name.parse::<RawFd>().ok());
        if let Some(fd) = fd
            && port(fd).is_some()
        {
            found.insert(fd);
        }
    }
    Ok(found)
}

/// Runs `with` on a file descriptor that another part of this process owns.
fn borrow<T>(fd: RawFd, with: impl FnOnce(SockRef<'_>) -> io::Result<T>) -> io::Result<T> {
    // SAFETY: the number was just read from /proc/self/fd, and is not used after this call. If it is closed meanwhile,
    // the system calls in `with` fail, or meet another socket, whose port then decides.
    let fd = unsafe { BorrowedFd::borrow_raw(fd) };
    with(SockRef::from(&fd))
}

/// The port of a UDP socket of IPv4 that is bound to every address; `None` for any other file descriptor.
fn port(fd: RawFd) -> Option<u16> {
    let address = borrow(fd, |socket| match socket.r#type()? {
        Type::DGRAM => socket.local_addr(),
        _ => Err(io::ErrorKind::Unsupported.into()),
    });
    let address = address.ok()?.as_socket_ipv4()?;
    (*address.ip() == Ipv4Addr::UNSPECIFIED).then_some(address.port())
}

/// Accepts only datagrams by interfaces with one of `addresses`, by loopback, or from this host.
///
/// `before`: the process's UDP sockets before the participant was made.
pub(in crate::dds) fn confine(
    ports: &Ports,
    before: &BTreeSet<RawFd>,
    addresses: &[IpAddr],
) -> io::Result<()> {
    let interfaces = if_addrs::get_if_addrs()?;
    let is_meant = |interface: &&if_addrs::Interface| {
        interface.is_loopback() || addresses.contains(&interface.ip())
    };
    let allowed = interfaces.iter().filter(is_meant);
    let allowed: BTreeSet<u32> = allowed.filter_map(|interface| interface.index).collect();
    let own = interfaces
        .iter()
        .filter_map(|interface| match interface.ip() {
            IpAddr::V4(address) => Some(address),
            IpAddr::V6(_) => None,
        });
    let filter = program(&allowed, &own.collect());

    let (all, expected) = (sockets()?, ports.all());
    let of_rtps: Vec<RawFd> = all
        .iter()
        .copied()
        .filter(|fd| port(*fd).is_some_and(|port| expected.contains(&port)))
        .collect();
    let has_user_port = of_rtps.iter().any(|fd| port(*fd) == Some(ports.user()));
    // if another program has the port, rustdds chose any other
    let others = all.difference(before).filter(|_| !has_user_port);
    for fd in of_rtps.iter().chain(others) {
        borrow(*fd, |socket| socket.attach_filter(&filter))?;
    }
    Ok(())
}

/// Returns 0 bytes of each rejected datagram.
fn program(interfaces: &BTreeSet<u32>, own: &BTreeSet<Ipv4Addr>) -> Vec<SockFilter> {
    const LOOPBACK: u32 = 0x7f00_0000;
    let accept = || SockFilter::new(bpf::RETURN, 0, 0, bpf::ALL);
    let mut program = vec![SockFilter::new(bpf::LOAD, 0, 0, bpf::INTERFACE)];
    for index in interfaces {
        program.extend([SockFilter::new(bpf::JUMP_EQUAL, 0, 1, *index), accept()]);
    }
    program.push(SockFilter::new(bpf::LOAD, 0, 0, bpf::SOURCE));
    for address in own {
        let address = u32::from(*address);
        program.extend([SockFilter::new(bpf::JUMP_EQUAL, 0, 1, address), accept()]);
    }
    program.extend([
        SockFilter::new(bpf::AND, 0, 0, 0xff00_0000),
        SockFilter::new(bpf::JUMP_EQUAL, 0, 1, LOOPBACK),
        accept(),
        SockFilter::new(bpf::RETURN, 0, 0, 0),
    ]);
    program
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{net::UdpSocket, time::Duration};

    /// The kernel runs the program on datagrams of loopback.
    #[test]
    fn kernel_drops_datagrams_that_the_program_rejects() {
        let listener = UdpSocket::bind("127.0.0.1:0").unwrap();
        listener
            .set_read_timeout(Some(Duration::from_secs(5)))
            .unwrap();
        let sender = UdpSocket::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let lo = if_addrs::get_if_addrs().unwrap();
        let lo = lo.iter().find(|interface| interface.is_loopback()).unwrap();
        let lo = lo.index.unwrap();
        let socket = SockRef::from(&listener);
        let mut buffer = [0];
        let refuses_all = vec![SockFilter::new(bpf::RETURN, 0, 0, 0)];
        for (filter, is_let_in) in [
            (program(&[lo].into(), &BTreeSet::new()), true),
            // by its source
            (program(&[lo + 77].into(), &BTreeSet::new()), true),
            (refuses_all, false),
        ] {
            socket.attach_filter(&filter).unwrap();
            sender.send_to(&[1], address).unwrap();
            if is_let_in {
                assert_eq!(listener.recv(&mut buffer).unwrap(), 1);
            }
            socket.detach_filter().unwrap();
            sender.send_to(&[2], address).unwrap();
            assert_eq!(listener.recv(&mut buffer).unwrap(), 1);
            assert_eq!(buffer, [2], "the datagram before was to be dropped");
        }
    }

    #[test]
    fn only_udp_sockets_on_all_addresses_are_found() {
        use std::os::fd::AsRawFd as _;
        let [any, one] = ["0.0.0.0:0", "127.0.0.1:0"].map(|at| UdpSocket::bind(at).unwrap());
        let tcp = std::net::TcpListener::bind("0.0.0.0:0").unwrap();
        let found = sockets().unwrap();
        assert!(found.contains(&any.as_raw_fd()));
        assert!(!found.contains(&one.as_raw_fd()) && !found.contains(&tcp.as_raw_fd()));
    }
}
