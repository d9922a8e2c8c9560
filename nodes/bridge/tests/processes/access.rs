//! Access control by Zenoh's configuration file: TLS with certificates on both sides, and rules for the name in the
//! certificate.

use crate::harness::{PATIENCE, Process, Site, bridge, fresh_domain, fresh_endpoint, soon, text};
use rcgen::{
    BasicConstraints, CertificateParams, CertifiedIssuer, DnType, IsCa, KeyPair, KeyUsagePurpose,
};
use serde_json::{Value, json};
use std::{
    path::{Path, PathBuf},
    time::Duration,
};
use wm_msgs::std_msgs::String as Text;
use wm_ros::{Publisher, Qos, Subscription};

const ADDRESS: &str = "127.0.0.1";

struct Authority(CertifiedIssuer<'static, KeyPair>);

impl Authority {
    fn new(name: &str) -> Self {
        let mut params = named(name);
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
        Self(CertifiedIssuer::self_signed(params, KeyPair::generate().unwrap()).unwrap())
    }
}

/// A certificate for this name on loopback.
fn named(name: &str) -> CertificateParams {
    let mut params = CertificateParams::new([ADDRESS.to_owned()]).unwrap();
    params.distinguished_name.push(DnType::CommonName, name);
    params
}

/// Bridges of one network: their endpoint and trusted authority.
struct Network {
    files: tempfile::TempDir,
    endpoint: String,
    trusted: Authority,
}

impl Network {
    fn new() -> Self {
        Self {
            files: tempfile::tempdir().unwrap(),
            endpoint: fresh_endpoint().replace("tcp/", "quic/"),
            trusted: Authority::new("the network's"),
        }
    }

    fn write(&self, file: &str, text: &str) -> PathBuf {
        let path = self.files.path().join(file);
        std::fs::write(&path, text).unwrap();
        path
    }

    /// The configuration file of a bridge with this name, certified by `authority`.
    fn configuration(&self, name: &str, authority: &Authority, more: Value) -> PathBuf {
        let key = KeyPair::generate().unwrap();
        let certificate = named(name).signed_by(&key, &authority.0).unwrap();
        let trusted = self.write("trusted.pem", &self.trusted.0.pem());
        let certificate = self.write(&format!("{name}.pem"), &certificate.pem());
        let key = self.write(&format!("{name}.key"), &key.serialize_pem());
        let mut configuration = json!({ "transport": { "link": { "tls": {
            "root_ca_certificate": trusted,
            "enable_mtls": true,
            "listen_certificate": certificate,
            "listen_private_key": key,
            "connect_certificate": certificate,
            "connect_private_key": key,
        } } } });
        configuration
            .as_object_mut()
            .unwrap()
            .extend(more.as_object().unwrap().clone());
        self.write(&format!("{name}.json5"), &configuration.to_string())
    }

    fn bridge(&self, domain: u16, side: &str, configuration: &Path) -> Process {
        let configuration = configuration.to_str().unwrap();
        bridge(domain, &["--config", configuration, side, &self.endpoint])
    }
}

/// One side publishes it, the other subscribes to it.
async fn topic(name: &str, here: &Site, there: &Site) -> (Publisher<Text>, Subscription<Text>) {
    let said = here
        .node
        .publisher::<Text>(name, Qos::reliable(10))
        .unwrap();
    let heard = there
        .node
        .subscription::<Text>(name, Qos::reliable(10))
        .unwrap();
    soon("connecting", async {
        said.wait_for_subscribers(1).await;
        heard.wait_for_publishers(1).await;
    })
    .await;
    (said, heard)
}

async fn next(heard: &mut Subscription<Text>) -> String {
    soon("a message", heard.recv()).await.unwrap().message.data
}

/// Connects at once, or ends.
fn without_patience(limit: Duration) -> Value {
    json!({ "connect": { "timeout_ms": limit.as_millis() as u64, "exit_on_failure": true } })
}

#[tokio::test(flavor = "multi_thread")]
async fn bridge_without_a_trusted_certificate_is_rejected() {
    let network = Network::new();
    let (domain_here, domain_there) = (fresh_domain(), fresh_domain());
    let here = network.configuration("here", &network.trusted, json!({}));
    let there = network.configuration("there", &network.trusted, without_patience(PATIENCE));
    let _bridge_here = network.bridge(domain_here, "--listen", &here);
    let _bridge_there = network.bridge(domain_there, "--connect", &there);
    let (here, there) = (Site::join(domain_here), Site::join(domain_there));
    let (said, mut heard) = topic("said", &here, &there).await;
    said.publish(&text("over TLS")).unwrap();
    assert_eq!(next(&mut heard).await, "over TLS");

    // only the authority differs, and the network exists
    let others = Authority::new("another's");
    let limit = Duration::from_secs(2);
    let stranger = network.configuration("stranger", &others, without_patience(limit));
    let stranger = network.bridge(fresh_domain(), "--connect", &stranger);
    let status = stranger.finish(PATIENCE);
    assert_eq!(status.code(), Some(1), "{status}");
    said.publish(&text("still")).unwrap();
    assert_eq!(next(&mut heard).await, "still");
}

#[tokio::test(flavor = "multi_thread")]
async fn access_control_denies_a_key_to_the_holder_of_a_certificate() {
    let network = Network::new();
    let (domain_robot, domain_desk) = (fresh_domain(), fresh_domain());
    let access_control = json!({ "access_control": {
        "enabled": true,
        "default_permission": "allow",
        "rules": [{
            "id": "secret",
            "key_exprs": ["wm/secret"],
            "messages": ["put"],
            "flows": ["egress"],
            "permission": "deny",
        }],
        "subjects": [{ "id": "desk", "cert_common_names": ["desk"] }],
        "policies": [{ "rules": ["secret"], "subjects": ["desk"] }],
    } });
    let robot = network.configuration("robot", &network.trusted, access_control);
    let desk = network.configuration("desk", &network.trusted, json!({}));
    let _bridge_robot = network.bridge(domain_robot, "--listen", &robot);
    let _bridge_desk = network.bridge(domain_desk, "--connect", &desk);
    let (robot, desk) = (Site::join(domain_robot), Site::join(domain_desk));
    let (secret, mut no_secret) = topic("secret", &robot, &desk).await;
    let (open, mut heard) = topic("open", &robot, &desk).await;
    for number in 0..10 {
        secret.publish(&text("secret")).unwrap();
        open.publish(&text(&number.to_string())).unwrap();
        assert_eq!(next(&mut heard).await, number.to_string());
    }
    assert!(no_secret.try_recv().is_none(), "what is denied came");
}
