//! The bridge's process: connects both sides and keeps the routes up to date.

use crate::{
    arguments::Arguments,
    others::{Others, Presence},
    plan::plan,
    routes::{Ends, Routes},
    settings::Settings,
};
use anyhow::{Context as _, Result};
use std::{collections::BTreeMap, sync::Arc, time::Duration};
use wm_ros::{Level, Node, RemoteEndpoint};

/// The graph changes in bursts; one update per burst suffices.
const SETTLE: Duration = Duration::from_millis(20);
/// How long threads may take to end.
const GRACE: Duration = Duration::from_millis(200);
const THREADS: usize = 2;
/// When both sides are usually discovered: a pattern without a match until then is reported.
const KNOWN: Duration = Duration::from_secs(10);

/// Runs the bridge until a signal.
///
/// # Errors
/// A side cannot be joined.
pub(crate) fn run(arguments: Arguments) -> Result<()> {
    let Arguments {
        config,
        settings,
        node: args,
    } = arguments;
    // some Zenoh calls block, which needs a runtime with several threads
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(THREADS)
        .enable_all()
        .build()?;
    let handle = runtime.handle().clone();
    let result = wm_ros::run("bridge", "/wm", &args, async move |node: Node| {
        node.seal_parameters()?;
        let carrying = handle.spawn(carry(node, config, settings));
        carrying.await.context("the bridge failed")?
    });
    runtime.shutdown_timeout(GRACE);
    result
}

async fn carry(node: Node, config: zenoh::Config, settings: Settings) -> Result<()> {
    let shutdown = node.shutdown();
    let session = tokio::select! {
        session = wm_ros::zenoh::open(config) => session?,
        () = shutdown.wait() => return Ok(()),
    };
    let own_id = session.zid().to_string();
    let others = Others::join(&session, node.participant()).await?;
    tracing::info!("connected to Zenoh as {own_id}");
    let mut changes = node.graph_changes();
    let ends = Arc::new(Ends {
        node,
        session,
        settings,
    });
    let mut routes = Routes::new(Arc::clone(&ends));
    let mut standing_by_for = None;
    let known = tokio::time::sleep(KNOWN);
    tokio::pin!(known);
    let mut is_known = false;
    loop {
        let endpoints = ends.node.remote_endpoints();
        let rival = rival(&own_id, &others.presences(), &endpoints);
        let wanted = match rival {
            None => plan(&endpoints, &others.announcements(), &ends.settings),
            Some(_) => BTreeMap::new(),
        };
        routes.follow(wanted).await;
        if rival != standing_by_for {
            report(&ends.node, rival.as_deref());
            standing_by_for = rival;
        }
        if others.refused() > 0 {
            let diagnostics = ends.node.diagnostics();
            diagnostics.set_value("announcements rejected [total]", others.refused());
        }
        tokio::select! {
            biased;
            () = shutdown.wait() => break,
            () = &mut known, if !is_known => {
                is_known = true;
                warn_of_unmatched(&ends.settings);
            }
            () = others.changed() => {}
            changed = changes.changed() => if changed.is_err() { break },
        }
        tokio::time::sleep(SETTLE).await;
        changes.borrow_and_update();
    }
    drop(routes);
    if let Err(error) = ends.session.close().await {
        tracing::debug!("the Zenoh session did not close: {error}");
    }
    Ok(())
}

/// The bridge with precedence, if any. Two active bridges between one DDS domain and one Zenoh network would carry
/// everything twice, and back again. The lower id has precedence.
fn rival(own_id: &str, others: &[Presence], endpoints: &[RemoteEndpoint]) -> Option<String> {
    let is_here = |presence: &&Presence| {
        let mut participants = endpoints.iter().map(|endpoint| endpoint.participant);
        participants.any(|participant| participant == presence.participant)
    };
    let here = others.iter().filter(is_here);
    let first = here.map(|presence| presence.bridge.as_str()).min()?;
    (first < own_id).then(|| first.to_owned())
}

fn warn_of_unmatched(settings: &Settings) {
    for pattern in settings.unmatched() {
        tracing::warn!(
            "allow or deny \"{pattern}\" has matched no name so far; it must match a whole name, like \".*/image.*\" \
             does"
        );
    }
}

fn report(node: &Node, rival: Option<&str>) {
    let diagnostics = node.diagnostics();
    match rival {
        Some(rival) => {
            let text = format!("standing by: the bridge {rival} joins this domain to the network");
            tracing::warn!("{text}");
            diagnostics.set_status(Level::Warn, text);
        }
        None => {
            tracing::info!(
                "no other bridge connects this domain to the network: this bridge is active"
            );
            diagnostics.set_status(Level::Ok, "running");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use wm_ros::{Qos, Role};

    #[test]
    fn bridge_with_the_lower_id_has_precedence() {
        let presence = |bridge: &str, byte| Presence {
            bridge: bridge.into(),
            participant: [byte; 12],
        };
        let endpoint = |byte| RemoteEndpoint {
            role: Role::Publisher,
            name: "/rosout".into(),
            type_name: "rcl_interfaces/msg/Log".into(),
            qos: Qos::reliable(10),
            participant: [byte; 12],
        };
        let others = [presence("1", 1), presence("2", 2), presence("8", 8)];
        let here = [endpoint(2), endpoint(2), endpoint(8), endpoint(9)];
        assert_eq!(rival("5", &others, &here).as_deref(), Some("2"));
        assert_eq!(rival("1a", &others, &here), None);
        assert_eq!(rival("5", &others, &[endpoint(9)]), None);
    }
}
