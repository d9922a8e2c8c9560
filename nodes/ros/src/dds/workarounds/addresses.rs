//! Changes of this host's addresses. rustdds 0.15.1 announces the addresses that it finds at its start, and joins the
//! multicast group on these only. The kernel drops the membership with the address. So after a change, a participant
//! would silently receive nothing.

use crate::{Environment, Error, Interface, Reach, lock::lock};
use std::{
    net::{IpAddr, Ipv4Addr},
    sync::Mutex,
};

/// The addresses that a participant uses.
pub(in crate::dds) struct Addresses {
    /// Without loopback, whose addresses do not change.
    used: Vec<Interface>,
    /// Whether it uses every interface.
    is_subnet: bool,
    changes: Mutex<Changes>,
}

#[derive(Default)]
struct Changes {
    /// Used addresses that are gone.
    missing: Vec<Interface>,
    /// New addresses that are not used, and were reported.
    unused: Vec<Interface>,
}

impl Addresses {
    /// The addresses of the interfaces that the environment names.
    ///
    /// # Errors
    /// The system does not list the interfaces.
    pub(in crate::dds) fn of(environment: &Environment) -> Result<Self, Error> {
        let addresses = environment.addresses();
        let is_used = |found: &Interface| match &addresses {
            Some(addresses) => addresses.contains(&found.address),
            None => true,
        };
        let used = outer(Interface::all()?).into_iter().filter(is_used);
        Ok(Self {
            used: used.collect(),
            is_subnet: environment.reach == Reach::Subnet,
            changes: Mutex::default(),
        })
    }

    /// The first IPv4 address; `None` if only loopback is used.
    pub(in crate::dds) fn first(&self) -> Option<Ipv4Addr> {
        self.used.iter().find_map(|used| match used.address {
            IpAddr::V4(address) => Some(address),
            IpAddr::V6(_) => None,
        })
    }

    /// The change of a used address. A lost address is logged once; it may return.
    pub(in crate::dds) fn check(&self) -> Option<Error> {
        if self.used.is_empty() && !self.is_subnet {
            return None;
        }
        match Interface::all() {
            Ok(now) => self.change(&outer(now)),
            Err(error) => {
                tracing::debug!("{error}");
                None
            }
        }
    }

    fn change(&self, now: &[Interface]) -> Option<Error> {
        let mut changes = lock(&self.changes);
        for used in &self.used {
            if !now.contains(used) && !changes.missing.contains(used) {
                tracing::warn!(
                    "{} has lost its address {}: nothing is sent or received there until it is back",
                    used.name,
                    used.address
                );
                changes.missing.push(used.clone());
            }
        }
        let is_new = |found: &&Interface| !self.used.contains(found);
        for missing in &changes.missing {
            let mut of_same = now.iter().filter(|found| found.name == missing.name);
            let found = of_same.find(|found| *found == missing || is_new(found));
            // with every interface in use, one network may replace another
            let other = now.iter().find(|found| self.is_subnet && is_new(found));
            if let Some(found) = found.or(other) {
                return Some(Error::AddressChanged {
                    interface: missing.name.clone(),
                    before: missing.address,
                    now: found.address,
                });
            }
        }
        if self.is_subnet {
            for found in now.iter().filter(is_new) {
                if !changes.unused.contains(found) {
                    tracing::warn!(
                        "{} has a new address {}, which this node does not use: restart it to use it",
                        found.name,
                        found.address
                    );
                    changes.unused.push(found.clone());
                }
            }
        }
        None
    }
}

fn outer(interfaces: Vec<Interface>) -> Vec<Interface> {
    let is_outer = |found: &Interface| !found.address.is_loopback();
    interfaces.into_iter().filter(is_outer).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn interface(name: &str, address: &str) -> Interface {
        Interface {
            name: name.to_owned(),
            address: address.parse().unwrap(),
        }
    }

    fn addresses(used: &[Interface], is_subnet: bool) -> Addresses {
        let used = used.to_vec();
        let changes = Mutex::default();
        Addresses {
            used,
            is_subnet,
            changes,
        }
    }

    #[test]
    fn new_address_of_the_interface_is_a_change() {
        let (before, now) = (interface("eth0", "10.0.0.1"), interface("eth0", "10.0.0.5"));
        let other = interface("wlan0", "10.0.1.1");
        let addresses = addresses(std::slice::from_ref(&before), false);
        assert!(addresses.change(&[before.clone(), other.clone()]).is_none());
        assert!(
            addresses.change(std::slice::from_ref(&other)).is_none(),
            "gone"
        );
        let error = addresses.change(&[other, now]).unwrap().to_string();
        assert!(
            error.contains("eth0 has changed from 10.0.0.1 to 10.0.0.5"),
            "{error}"
        );
    }

    #[test]
    fn returning_address_is_a_change() {
        let used = interface("eth0", "10.0.0.1");
        let addresses = addresses(std::slice::from_ref(&used), true);
        assert!(addresses.change(&[]).is_none());
        assert!(addresses.change(&[used]).is_some());
    }

    #[test]
    fn second_network_is_no_change_while_the_first_works() {
        let (used, new) = (interface("eth0", "10.0.0.1"), interface("tun0", "10.8.0.2"));
        let addresses = addresses(std::slice::from_ref(&used), true);
        assert!(addresses.change(&[used, new.clone()]).is_none());
        assert!(addresses.change(&[new]).is_some());
    }
}
