//! Participants of one process on loopback.

use super::{names::tests::endpoint, *};
use crate::{backend::WhenFull, payload::Payload};

const PATIENCE: std::time::Duration = std::time::Duration::from_secs(20);

/// The domain of this process among the twenty from `first` on.
fn domain(first: u16) -> u16 {
    first + (std::process::id() % 20) as u16
}

#[tokio::test(flavor = "multi_thread")]
async fn response_waits_until_its_client_is_connected() {
    let environment = on_loopback(domain(100));
    let join = || Dds::join(&environment, Handle::current()).unwrap();
    let (server, client) = (join(), join());
    let (calls, mut called) = tokio::sync::mpsc::unbounded_channel();
    let sink = move |sample: Result<crate::backend::Sample, String>| {
        calls.send(sample.unwrap().request.unwrap()).unwrap();
    };
    let _requests = server
        .reader("/server", &endpoint(Channel::Request), Box::new(sink))
        .unwrap();
    let answers = server
        .writer("/server", &endpoint(Channel::Response))
        .unwrap();
    let requests = client
        .writer("/client", &endpoint(Channel::Request))
        .unwrap();
    let sample = bytes::Bytes::from_static(&[0, 1, 0, 0, 7, 0, 0, 0]);

    let mut changes = client.changes();
    while client.matched(&requests.id()) == 0 {
        tokio::time::timeout(PATIENCE, changes.changed())
            .await
            .unwrap()
            .unwrap();
    }
    let payload = Payload::Cdr(sample.clone());
    requests
        .write(&payload, None, WhenFull::DropOldest)
        .unwrap();
    let request = tokio::time::timeout(PATIENCE, called.recv())
        .await
        .unwrap()
        .unwrap();
    // The client has no reader yet: a response sent now would be lost.
    let written = answers
        .write(&payload, Some(request), WhenFull::DropOldest)
        .unwrap();
    assert_eq!(written, crate::backend::WriteOutcome::Held);

    let (heard, mut hears) = tokio::sync::mpsc::unbounded_channel();
    let sink = move |sample: Result<crate::backend::Sample, String>| {
        heard.send(sample.unwrap().payload.cdr().unwrap()).unwrap();
    };
    let _answers = client
        .reader("/client", &endpoint(Channel::Response), Box::new(sink))
        .unwrap();
    let answer = tokio::time::timeout(PATIENCE, hears.recv())
        .await
        .unwrap()
        .unwrap();
    assert_eq!(answer, sample);
}

/// A killed server stays connected until its lease ends, and its successor connects one end after the other. A call that is
/// sent in between is lost.
#[tokio::test(flavor = "multi_thread")]
async fn two_halves_of_servers_are_no_server() {
    let environment = on_loopback(domain(20));
    let join = || Dds::join(&environment, Handle::current()).unwrap();
    let [client, one, other] = [join(), join(), join()];
    let takes_calls = |server: &Dds| {
        let ends = endpoint(Channel::Request);
        server.reader("/server", &ends, Box::new(drop)).unwrap()
    };
    let answers = |server: &Dds| {
        let ends = endpoint(Channel::Response);
        server.writer("/server", &ends).unwrap()
    };
    let requests = client
        .writer("/client", &endpoint(Channel::Request))
        .unwrap();
    let responses = client
        .reader("/client", &endpoint(Channel::Response), Box::new(drop))
        .unwrap();
    let wait = async |is_so: &dyn Fn() -> bool| {
        let mut changes = client.changes();
        while !is_so() {
            let change = tokio::time::timeout(PATIENCE, changes.changed()).await;
            change.unwrap().unwrap();
        }
    };
    let (requests, responses) = (requests.id(), responses.id());
    let (_takes, _answers) = (takes_calls(&one), answers(&other));
    wait(&|| client.matched(&requests) > 0 && client.matched(&responses) > 0).await;
    assert!(!client.has_server(&requests, &responses));
    let _second_end = answers(&one);
    wait(&|| client.has_server(&requests, &responses)).await;
}

/// Simulates lost events.
#[tokio::test(flavor = "multi_thread")]
async fn lost_discovery_events_are_repaired() {
    let environment = on_loopback(domain(80));
    let join = || Dds::join(&environment, Handle::current()).unwrap();
    let (here, there) = (join(), join());
    let writer = here.writer("/here", &endpoint(Channel::Topic)).unwrap();
    let _reader = there
        .reader("/there", &endpoint(Channel::Topic), Box::new(drop))
        .unwrap();
    let mut changes = here.changes();
    while here.matched(&writer.id()) == 0 {
        let change = tokio::time::timeout(PATIENCE, changes.changed()).await;
        change.unwrap().unwrap();
    }
    // late events arrive by themselves, and then there are no differences
    let mut reconciler = Reconciler::new(Arc::clone(&here.shared));
    let settled = async {
        let mut quiet_rounds = 0;
        while quiet_rounds < 3 {
            quiet_rounds = match reconciler.reconcile() {
                true => 0,
                false => quiet_rounds + 1,
            };
            tokio::time::sleep(std::time::Duration::from_millis(100)).await;
        }
    };
    tokio::time::timeout(PATIENCE, settled).await.unwrap();

    let (known, ghost) = (here.shared.matched(&writer.id()), [9; 16]);
    lock(&here.shared.matches).insert(writer.id(), [ghost].into());
    // A difference is repaired when it is found the second time, and a new match that has no effect shows a lost event.
    (0..3).for_each(|_| {
        reconciler.reconcile();
    });
    assert_eq!(here.shared.matched(&writer.id()), known);
}

#[tokio::test(flavor = "multi_thread")]
async fn panic_in_subscription_fails_the_participant() {
    let environment = Environment {
        domain_id: 0,
        reach: crate::Reach::Process,
        middleware: crate::Middleware::Dds,
    };
    let dds = Dds::join(&environment, Handle::current()).unwrap();
    let sink = Box::new(|_: Result<crate::backend::Sample, String>| panic!("on purpose"));
    let _reader = dds.reader("/here", &endpoint(Channel::Topic), sink);
    let writer = dds.writer("/here", &endpoint(Channel::Topic)).unwrap();
    assert!(dds.failure().is_none());
    let payload = Payload::Cdr(bytes::Bytes::from_static(&[0, 1, 0, 0, 7, 0, 0, 0]));
    writer.write(&payload, None, WhenFull::DropOldest).unwrap();
    let failed = async {
        loop {
            if let Some(error) = dds.failure() {
                return error.to_string();
            }
            // Each check asserts liveliness. Without a pause, the checks fill the queue of rustdds 0.15.1's discovery,
            // and it deadlocks.
            tokio::time::sleep(std::time::Duration::from_millis(10)).await;
        }
    };
    let failed = tokio::time::timeout(std::time::Duration::from_secs(20), failed).await;
    assert!(failed.unwrap().contains("on purpose"));
}

/// A busy receiver: its reader has acknowledged a sample, but takes it only after the writer was dropped. rustdds
/// forgets such a sample when the writer leaves.
#[test]
fn last_sample_of_a_dropped_writer_reaches_a_busy_reader() {
    let environment = on_loopback(domain(60));
    let runtime = |threads| {
        let mut builder = tokio::runtime::Builder::new_multi_thread();
        let builder = builder.worker_threads(threads).enable_all();
        builder.build().unwrap()
    };
    let (busy, free) = (runtime(1), runtime(1));
    let there = Dds::join(&environment, busy.handle().clone()).unwrap();
    let here = Dds::join(&environment, free.handle().clone()).unwrap();
    let (heard, hears) = std::sync::mpsc::channel();
    let sink = move |sample: Result<crate::backend::Sample, String>| {
        heard.send(sample.unwrap().payload.cdr().unwrap()).unwrap();
    };
    let reader = there.reader("/there", &endpoint(Channel::Topic), Box::new(sink));
    let reader = reader.unwrap();
    let writer = here.writer("/here", &endpoint(Channel::Topic)).unwrap();
    free.block_on(async {
        let (mut changes, mut others) = (here.changes(), there.changes());
        while here.matched(&writer.id()) == 0 {
            let changed = tokio::time::timeout(PATIENCE, changes.changed());
            changed.await.unwrap().unwrap();
        }
        while there.matched(&reader.id()) == 0 {
            let changed = tokio::time::timeout(PATIENCE, others.changed());
            changed.await.unwrap().unwrap();
        }
    });

    // keeps the only thread of the receiver's runtime busy
    let (go_on, goes_on) = std::sync::mpsc::channel::<()>();
    let (is_busy, got_busy) = std::sync::mpsc::channel();
    busy.spawn(async move {
        is_busy.send(()).unwrap();
        goes_on.recv().ok();
    });
    got_busy.recv_timeout(PATIENCE).unwrap();
    let sample = bytes::Bytes::from_static(&[0, 1, 0, 0, 7, 0, 0, 0]);
    writer
        .write(&Payload::Cdr(sample.clone()), None, WhenFull::DropOldest)
        .unwrap();
    free.block_on(async {
        let acknowledged = tokio::time::timeout(PATIENCE, writer.acknowledged());
        acknowledged.await.unwrap().unwrap();
    });
    drop(writer);
    // There is no event for a writer's departure: on loopback it takes a few milliseconds.
    std::thread::sleep(writer::HAND_OVER / 5);
    go_on.send(()).unwrap();
    assert_eq!(hears.recv_timeout(PATIENCE).unwrap(), sample);
}

/// Waits until each of these participants on loopback has discovered all others.
async fn all_meet(all: &[Arc<Dds>], patience: std::time::Duration) {
    let start = Instant::now();
    for (index, participant) in all.iter().enumerate() {
        let mut changes = participant.changes();
        let known = || participant.shared.parts.readers().len();
        while known() < all.len() - 1 {
            let left = patience.saturating_sub(start.elapsed());
            let change = tokio::time::timeout(left, changes.changed()).await;
            let Ok(changed) = change else {
                panic!("participant {index} knows {} of {}", known(), all.len() - 1)
            };
            changed.unwrap();
        }
    }
}

fn on_loopback(domain_id: u16) -> Environment {
    Environment {
        domain_id,
        reach: crate::Reach::Localhost,
        middleware: crate::Middleware::Dds,
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn participants_beyond_the_twelfth_discover_each_other() {
    let environment = on_loopback(40 + (std::process::id() % 10) as u16);
    let join = || Dds::join(&environment, Handle::current()).unwrap();
    let all: Vec<_> = std::iter::repeat_with(join).take(24).collect();
    all_meet(&all, std::time::Duration::from_secs(60)).await;
}

/// One after the other: together, their first announcements are two million datagrams.
#[tokio::test(flavor = "multi_thread")]
#[ignore = "long: as many participants as one host can have"]
async fn all_participants_of_a_full_domain_discover_each_other() {
    let (environment, start) = (on_loopback(50), Instant::now());
    let mut all = Vec::new();
    for number in 1..=120 {
        all.push(Dds::join(&environment, Handle::current()).unwrap());
        all_meet(&all, std::time::Duration::from_secs(60)).await;
        println!(
            "{number} participants know each other after {:.1?}",
            start.elapsed()
        );
    }
}

#[tokio::test]
async fn error_for_a_full_domain_names_it_and_the_remedy() {
    let domain_id = 51 + (std::process::id() % 9) as u16;
    let environment = on_loopback(domain_id);
    // other programs occupy the ports
    let port = |number: u16| 7400 + 250 * domain_id + 10 + 2 * number;
    let bind = |number| std::net::UdpSocket::bind(("0.0.0.0", port(number))).ok();
    let _taken: Vec<_> = (0..120).map(bind).collect();
    let joined = Dds::join(&environment, Handle::current());
    let error = joined.map(drop).unwrap_err().to_string();
    for text in [&format!("domain {domain_id}"), "120", "ROS_DOMAIN_ID"] {
        assert!(error.contains(text), "{error}");
    }
}
