//! Zenoh's configuration files, JSON5, with certificate and key inside.

use super::{
    authority::{Authority, Certified, Validity},
    identity::{Identity, file_of},
};
use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde_json::{Value, json};
use wm_ros::Role;

/// How long the answer of a service may take \[ms\].
const QUERY_TIMEOUT: u64 = 60_000;

/// The largest message \[byte\], and the batches that wait for a link, per priority: those of sessions without a file.
const LARGEST_MESSAGE: usize = 64 << 20;
const WAITING_BATCHES: usize = 16;

/// How long a session searches its router when it starts \[ms\].
const CONNECT_TIMEOUT: u64 = 10_000;

/// The router.
pub(super) fn router(
    certified: &Certified,
    authority: &Authority,
    endpoints: &[String],
    access: Value,
) -> String {
    let configuration = json!({
        "mode": "router",
        "listen": {"endpoints": endpoints},
        "connect": {"endpoints": []},
        // it neither searches others nor names them to others
        "scouting": {"multicast": {"enabled": false}, "gossip": {"enabled": false}},
        "timestamping": {"enabled": true},
        "queries_default_timeout": QUERY_TIMEOUT,
        "adminspace": {"enabled": false},
        "transport": {
            "unicast": {"accept_pending": 10_000, "max_sessions": 10_000},
            "link": link(json!({
                "enable_mtls": true,
                "root_ca_certificate_base64": STANDARD.encode(authority.pem()),
                "listen_certificate_base64": STANDARD.encode(&certified.certificate),
                "listen_private_key_base64": STANDARD.encode(&certified.key),
            })),
        },
        "access_control": access,
    });
    let comment = "// Zenoh's router, for ZENOH_ROUTER_CONFIG_URI. It admits only sessions with a certificate of this \
                   authority,\n// and each may do only what its rules allow. This file contains a private key: keep \
                   it secret.\n";
    format!("{comment}{configuration:#}\n")
}

/// The session of an identity, which connects to the first of these endpoints that answers.
pub(super) fn session(
    identity: &Identity,
    certified: &Certified,
    authority: &Authority,
    endpoints: &[String],
    validity: &Validity,
) -> String {
    let certificate = STANDARD.encode(&certified.certificate);
    let key = STANDARD.encode(&certified.key);
    let configuration = json!({
        // as peers, sessions would exchange messages past the router and its rules
        "mode": "client",
        "listen": {"endpoints": []},
        "connect": {
            "endpoints": endpoints,
            "timeout_ms": CONNECT_TIMEOUT,
            "exit_on_failure": true,
        },
        "scouting": {"multicast": {"enabled": false}, "gossip": {"enabled": false}},
        // latched topics need it
        "timestamping": {"enabled": true},
        "queries_default_timeout": QUERY_TIMEOUT,
        "adminspace": {"enabled": false},
        "transport": {
            "shared_memory": {"enabled": false},
            "link": link(json!({
                "enable_mtls": true,
                "verify_name_on_connect": true,
                "root_ca_certificate_base64": STANDARD.encode(authority.pem()),
                "connect_certificate_base64": certificate,
                "connect_private_key_base64": key,
            })),
        },
    });
    format!("{}{configuration:#}\n", comment(identity, validity))
}

/// Links by QUIC alone: TLS 1.3 over UDP. Zenoh's links by TLS over TCP break under load (`wm_ros::zenoh`).
fn link(tls: Value) -> Value {
    let queue = WAITING_BATCHES;
    json!({
        "protocols": ["quic"],
        "tls": tls,
        "rx": {"max_message_size": LARGEST_MESSAGE},
        "tx": {"queue": {"size": {
            "real_time": queue, "interactive_high": queue, "interactive_low": queue, "data_high": queue,
            "data": queue, "data_low": queue, "background": queue,
        }}},
    })
}

/// The purpose of the file, and the rights of its owner.
fn comment(identity: &Identity, validity: &Validity) -> String {
    let mut text = format!(
        "// Zenoh's session of {}, for ZENOH_SESSION_CONFIG_URI; {}, valid to {validity}.\n\
         // This file contains a private key: keep it secret. The router grants:\n",
        identity.name,
        file_of(&identity.name),
    );
    for (title, role) in [
        ("publish", Role::Publisher),
        ("subscribe", Role::Subscription),
        ("serve", Role::Server),
        ("call", Role::Client),
    ] {
        for name in identity.names(role) {
            text.push_str(&format!("//   {title} {name}\n"));
        }
    }
    text
}
