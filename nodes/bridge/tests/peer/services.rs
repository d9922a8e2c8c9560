//! Services.

use crate::{
    cyclone_node::{Body, CycloneNode},
    harness::soon,
    pair::Pair,
};
use std::time::Duration;
use wm_msgs::{
    cdr,
    diagnostic_msgs::DiagnosticArray,
    wm_msgs::{Reset, ResetRequest, ResetResponse},
};
use wm_ros::{Node, Qos, Role, Subscription};

fn request(seed: u64) -> ResetRequest {
    ResetRequest {
        seed,
        keep_seed: seed.is_multiple_of(2),
    }
}

/// A response that repeats the request.
fn answer(request: &ResetRequest) -> ResetResponse {
    ResetResponse {
        success: request.keep_seed,
        message: format!("seed {}", request.seed),
    }
}

/// Waits until this node does or does not see a server of `reset`.
async fn served(node: &Node, is_wanted: bool) {
    let mut changes = node.graph_changes();
    let is_served = || {
        let endpoints = node.remote_endpoints();
        let mut servers = endpoints.iter().filter(|it| it.role == Role::Server);
        servers.any(|server| server.name == "/wm/reset")
    };
    soon("the server's coming or going", async {
        while is_served() != is_wanted {
            changes.changed().await.unwrap();
        }
    })
    .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn client_behind_the_real_bridge_calls_a_service() {
    let pair = Pair::new(&[]);
    let mut service = pair.here.node.service::<Reset>("reset").unwrap();
    let mut node = CycloneNode::join(pair.domain_there);
    let client = node.client("reset");
    soon("finding the service", node.wait_for(&client)).await;
    let serving = tokio::spawn(async move {
        loop {
            let call = service.recv().await.unwrap();
            let answer = answer(&call.request);
            call.respond(&answer).unwrap();
        }
    });
    for seed in [7, u64::MAX, 0] {
        let wanted = answer(&request(seed));
        // a call of the real bridge within 0.1 s after the service's discovery may be lost
        soon("an answer", async {
            loop {
                let call = client.async_call_service(Body(request(seed)));
                match tokio::time::timeout(Duration::from_secs(2), call).await {
                    Ok(answered) => break assert_eq!(answered.unwrap().0, wanted),
                    Err(_) => continue,
                }
            }
        })
        .await;
    }
    // when the server ends, the remote server ends too
    served(&pair.there.node, true).await;
    serving.abort();
    served(&pair.there.node, false).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn service_behind_the_real_bridge_is_called() {
    let pair = Pair::new(&["--queries-timeout", "20"]);
    let client = pair.here.node.client::<Reset>("reset").unwrap();
    let mut node = CycloneNode::join(pair.domain_there);
    let server = node.server("reset");
    let serving = tokio::spawn(async move {
        for _ in 0..3 {
            let (id, Body(request)) = server.async_receive_request().await.unwrap();
            let answer = Body(answer(&request));
            server.async_send_response(id, answer).await.unwrap();
        }
        server
    });
    soon("finding the service", client.wait_for_service()).await;
    for seed in [7, u64::MAX, 0] {
        let request = request(seed);
        let answered = soon("an answer", client.call(&request)).await.unwrap();
        assert_eq!(answered, answer(&request));
    }
    drop(soon("serving", serving).await.unwrap());
    served(&pair.here.node, false).await;
}

/// Waits until the bridge reports a call without a response.
async fn told_of(reports: &mut Subscription<DiagnosticArray>) {
    let tells = |report: &DiagnosticArray| {
        let mut values = report.status.iter().flat_map(|status| &status.values);
        values.any(|it| it.key.contains("calls of zenoh wm/reset: not answered"))
    };
    soon("the report", async {
        while !tells(&reports.recv().await.unwrap().message) {}
    })
    .await;
}

fn reports(pair: &Pair) -> Subscription<DiagnosticArray> {
    let qos = Qos::reliable(10);
    pair.here.node.subscription("/diagnostics", qos).unwrap()
}

#[tokio::test(flavor = "multi_thread")]
async fn unanswered_call_behind_the_real_bridge_is_reported() {
    let pair = Pair::new(&["--queries-timeout", "0.5"]);
    let mut reports = reports(&pair);
    let client = pair.here.node.client::<Reset>("reset").unwrap();
    let mut node = CycloneNode::join(pair.domain_there);
    let server = node.server("reset");
    soon("finding the service", client.wait_for_service()).await;
    let calling = tokio::spawn(async move { client.call(&request(7)).await });
    let asked = soon("the request", server.async_receive_request()).await;
    assert_eq!(asked.unwrap().1, Body(request(7)));
    told_of(&mut reports).await;
    calling.abort();
}

/// A fault of the real bridge: it writes 16 bytes in front of the request, which only servers of rmw_cyclonedds expect.
#[tokio::test(flavor = "multi_thread")]
async fn real_bridge_corrupts_requests_to_other_rmws() {
    let pair = Pair::new(&["--queries-timeout", "0.5"]);
    let mut reports = reports(&pair);
    let client = pair.here.node.client::<Reset>("reset").unwrap();
    let there = &pair.there.node;
    let mut service = there
        .raw_service_for_others("reset", "wm_msgs/srv/Reset")
        .unwrap();
    soon("finding the service", client.wait_for_service()).await;
    let calling = tokio::spawn(async move { client.call(&request(7)).await });
    let call = soon("the request", service.recv()).await.unwrap();
    let sent = cdr::to_bytes(&request(7)).unwrap();
    let (head, body) = sent.split_at(4);
    assert!(call.request.starts_with(head), "{:?}", call.request);
    assert!(call.request[20..].starts_with(body), "{:?}", call.request);
    let answer = cdr::to_bytes(&answer(&request(7))).unwrap();
    call.respond(answer.into()).unwrap();
    told_of(&mut reports).await;
    calling.abort();
}
