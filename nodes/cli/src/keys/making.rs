//! The files of `wm keys`.

use super::{
    KeysCommand, MAX_DOMAIN, access,
    authority::{self, Authority, Purpose, Validity},
    configuration, folder,
    grant::Grant,
    identity::{self, Identity, file_of},
    suite,
};
use crate::output::print;
use anyhow::{Context as _, Result};
use clap::error::ErrorKind;
use std::process::ExitCode;
use wm_ros::NodeArgs;

/// The address at which sessions on the router's host reach it. Other names of this host are in its certificate too, for
/// configurations that users write.
const LOCAL_ADDRESS: &str = "127.0.0.1";
const LOCAL_NAMES: [&str; 3] = [LOCAL_ADDRESS, "localhost", "::1"];

impl KeysCommand {
    pub(crate) fn run(self, ros_args: Vec<String>) -> Result<ExitCode> {
        let args = NodeArgs::parse(ros_args)?;
        let domain = match self.domain {
            Some(domain) => domain,
            None => domain_of_environment()?,
        };
        let mut identities = match &self.launch {
            Some(file) => suite::of_launch(file, &self.launch_arguments)?,
            None => suite::of_nodes(&self.only, &self.namespace, &args)?,
        };
        for nodes in &self.together {
            let names: Vec<&str> = nodes.split(',').map(str::trim).collect();
            identities.push(suite::together(&names, &self.namespace, &args)?);
        }
        for grant in &self.node {
            parsed(grant).apply(&mut identities, &self.namespace)?;
        }
        for grant in &self.tool {
            identities.push(parsed(grant).tool());
        }
        identity::check_distinct(&identities)?;
        let validity = Validity::days(self.days)?;
        let authority = match &self.authority {
            Some(folder) => Authority::open(folder)?,
            None => Authority::new(&validity)?,
        };
        let files = self.files(&authority, &validity, domain, &identities)?;
        folder::write(&self.directory, &files)?;
        print(self.summary(&identities, &validity))?;
        for note in identities.iter().filter_map(Identity::note) {
            eprintln!("{note}");
        }
        Ok(ExitCode::SUCCESS)
    }

    /// All files, by name.
    fn files(
        &self,
        authority: &Authority,
        validity: &Validity,
        domain: u16,
        identities: &[Identity],
    ) -> Result<Vec<(String, String)>> {
        let mut files = vec![
            (
                authority::CERTIFICATE.to_owned(),
                authority.pem().to_owned(),
            ),
            (authority::KEY.to_owned(), authority.key().to_owned()),
        ];
        let names = self.names(&LOCAL_NAMES);
        let router = authority.issue("router", Purpose::Router(&names), validity)?;
        let access = access::control(domain, identities)?;
        let router = configuration::router(&router, authority, &self.listened(), access);
        files.push(("router.json5".to_owned(), router));
        let hosts = self.names(&[LOCAL_ADDRESS]);
        let endpoints: Vec<_> = hosts.iter().map(|host| self.endpoint(host)).collect();
        for identity in identities {
            let certificate = authority.issue(&identity.name, Purpose::Session, validity)?;
            let session =
                configuration::session(identity, &certificate, authority, &endpoints, validity);
            files.push((file_of(&identity.name), session));
        }
        Ok(files)
    }

    /// These names of the router's host, and those of the command line.
    fn names(&self, local: &[&str]) -> Vec<String> {
        let given = self.host.iter().map(String::as_str);
        let others = given.filter(|host| !local.contains(host));
        local
            .iter()
            .copied()
            .chain(others)
            .map(str::to_owned)
            .collect()
    }

    /// Other hosts reach the router only if one is named.
    fn listened(&self) -> Vec<String> {
        match self.host.is_empty() {
            true => vec![self.endpoint(LOCAL_ADDRESS)],
            false => vec![self.endpoint("::")],
        }
    }

    fn endpoint(&self, host: &str) -> String {
        let port = self.port;
        match host.contains(':') {
            true => format!("quic/[{host}]:{port}"),
            false => format!("quic/{host}:{port}"),
        }
    }

    fn summary(&self, identities: &[Identity], validity: &Validity) -> String {
        let directory = self.directory.display();
        let mut text = format!(
            "{directory}: an authority, a router and {} sessions, valid to {validity}\n",
            identities.len()
        );
        for identity in identities {
            text.push_str(&format!(
                "  {}  {}\n",
                file_of(&identity.name),
                identity.name
            ));
        }
        text.push_str(&format!(
            "Keep {directory}/{} secret and off the robot: it signs certificates.\n",
            authority::KEY
        ));
        text
    }
}

/// Ends the process with exit code 2 if it is malformed.
fn parsed(grant: &str) -> Grant {
    grant.parse().unwrap_or_else(|error| {
        let message = format!("`{grant}`: {error}\n");
        clap::Error::raw(ErrorKind::InvalidValue, message).exit()
    })
}

fn domain_of_environment() -> Result<u16> {
    let Ok(text) = std::env::var("ROS_DOMAIN_ID") else {
        return Ok(0);
    };
    if text.is_empty() {
        return Ok(0);
    }
    let domain = text.parse().ok().filter(|domain| *domain <= MAX_DOMAIN);
    domain.with_context(|| {
        format!("ROS_DOMAIN_ID is `{text}`: expected a number from 0 to {MAX_DOMAIN}")
    })
}
