//! Two hosts with an Ethernet between them: network namespaces, gone when the test lets go of them.

use std::{
    process::Command,
    sync::atomic::{AtomicU16, Ordering},
};

pub const FIRST: &str = "10.213.7.1";
pub const SECOND: &str = "10.213.7.2";
/// The interface of both hosts.
pub const ETHERNET: &str = "wmeth";

/// Runs a command; its error as text.
pub fn run(words: &str) -> Result<(), String> {
    let mut parts = words.split(' ');
    let output = Command::new(parts.next().unwrap()).args(parts).output();
    match output {
        Ok(output) if output.status.success() => Ok(()),
        Ok(output) => Err(String::from_utf8_lossy(&output.stderr).trim().to_owned()),
        Err(error) => Err(error.to_string()),
    }
}

/// Runs a command that must succeed.
pub fn must(words: &str) {
    run(words).unwrap_or_else(|reason| panic!("{words}: {reason}"));
}

/// Two namespaces with a cable between them.
pub struct Network {
    pub first: String,
    pub second: String,
}

/// Which packets are dropped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cut {
    Both,
    /// Those to the first host.
    ToFirst,
    /// Those to the second host.
    ToSecond,
    /// The cable is unplugged.
    Cable,
}

impl Network {
    /// `None` (with a plain message) where namespaces are not allowed.
    pub fn new() -> Option<Self> {
        static NEXT: AtomicU16 = AtomicU16::new(0);
        let number = NEXT.fetch_add(1, Ordering::Relaxed);
        let name = |host: &str| format!("wm{host}{number}x{}", std::process::id());
        let network = Self {
            first: name("a"),
            second: name("b"),
        };
        let Self { first, second } = &network;
        if let Err(reason) = run(&format!("ip netns add {first}")) {
            eprintln!("skipped: network namespaces are not allowed here: {reason}");
            return None;
        }
        must(&format!("ip netns add {second}"));
        must(&format!(
            "ip -n {first} link add {ETHERNET} type veth peer name {ETHERNET} netns {second}"
        ));
        for (host, address) in [(first, FIRST), (second, SECOND)] {
            must(&format!(
                "ip -n {host} addr add {address}/24 dev {ETHERNET}"
            ));
            must(&format!("ip -n {host} link set {ETHERNET} up"));
            must(&format!("ip -n {host} link set lo up"));
            must(&format!(
                "ip -n {host} route add 224.0.0.0/4 dev {ETHERNET}"
            ));
        }
        Some(network)
    }

    /// The words in front of a command that runs on a host.
    pub fn on(host: &str) -> [&str; 4] {
        ["ip", "netns", "exec", host]
    }

    pub fn cut(&self, cut: Cut) {
        let to_first = matches!(cut, Cut::Both | Cut::ToFirst).then_some(&self.first);
        let to_second = matches!(cut, Cut::Both | Cut::ToSecond).then_some(&self.second);
        for host in to_first.into_iter().chain(to_second) {
            let script = format!(
                "nft add table inet cut && \
                 nft add chain inet cut in '{{ type filter hook input priority 0; }}' && \
                 nft add rule inet cut in iifname {ETHERNET} drop"
            );
            let output = Command::new("ip")
                .args(["netns", "exec", host, "sh", "-c", &script])
                .output()
                .unwrap();
            let said = String::from_utf8_lossy(&output.stderr);
            assert!(output.status.success(), "{said}");
        }
        if cut == Cut::Cable {
            must(&format!("ip -n {} link set {ETHERNET} down", self.first));
        }
    }

    /// Ends a cut.
    pub fn mend(&self, cut: Cut) {
        if cut == Cut::Cable {
            must(&format!("ip -n {} link set {ETHERNET} up", self.first));
            must(&format!(
                "ip -n {} route replace 224.0.0.0/4 dev {ETHERNET}",
                self.first
            ));
            return;
        }
        for host in [&self.first, &self.second] {
            // the other host may have none
            run(&format!("ip netns exec {host} nft delete table inet cut")).ok();
        }
    }
}

impl Drop for Network {
    fn drop(&mut self) {
        for name in [&self.first, &self.second] {
            run(&format!("ip netns del {name}")).ok();
        }
    }
}
