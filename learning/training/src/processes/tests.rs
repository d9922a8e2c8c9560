use std::{
    io::{Read as _, Write as _},
    net::{SocketAddr, TcpListener, TcpStream},
    ops::Range,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::Result;
use serde_json::json;

use super::{
    connection::Connection,
    frame::{
        Kind, Part, read_header, read_job, read_magic, read_message, read_message_body,
        write_magic, write_message, write_sums,
    },
    message::{EndState, Message},
    *,
};
use crate::{
    gradient_tree::{GradientTree, Node},
    run::{RunEnd, StepLoss, Stop},
};

/// Batches of a step.
const COUNT: usize = 6;
const SIZES: [usize; 2] = [3, 2];

/// A gradient that depends on weights, step and batch, in sums that depend on their order.
fn leaf(step: u64, batch: usize, weights: &[Vec<f32>]) -> StepLoss {
    let factor = 1.0 / (1 + batch * batch) as f32 + step as f32 * 0.1;
    let times = |values: &Vec<f32>| values.iter().map(|value| value * factor).collect();
    StepLoss {
        loss: factor,
        parts: Vec::new(),
        gradient: weights.iter().map(times).collect(),
    }
}

fn weights(step: u64) -> Vec<Vec<f32>> {
    let value = |index: usize| 1.0 / (step as f32 + 3.0 + index as f32);
    SIZES
        .iter()
        .map(|size| (0..*size).map(value).collect())
        .collect()
}

/// The result of one process.
fn alone(step: u64) -> StepLoss {
    let tree = GradientTree::new(COUNT);
    let weights = weights(step);
    (0..COUNT).for_each(|batch| tree.add_leaf(batch, leaf(step, batch, &weights)));
    tree.into_root().unwrap()
}

/// The computation of a worker.
struct Toy {
    /// Factor on all gradients.
    factor: f32,
    computed: Arc<AtomicUsize>,
}

impl Computation for Toy {
    fn sizes(&self) -> Vec<usize> {
        SIZES.to_vec()
    }

    fn count(&self) -> usize {
        COUNT
    }

    fn sums(
        &mut self,
        step: u64,
        batches: Range<usize>,
        weights: &[Vec<f32>],
    ) -> Result<Vec<Node>> {
        self.computed.fetch_add(batches.len(), Ordering::SeqCst);
        let tree = GradientTree::new(COUNT);
        for batch in batches {
            let mut leaf = leaf(step, batch, weights);
            let values = leaf.gradient.iter_mut().flatten();
            values.for_each(|value| *value *= self.factor);
            tree.add_leaf(batch, leaf);
        }
        Ok(tree.into_nodes())
    }
}

fn offer() -> Offer {
    Offer {
        version: "1".into(),
        data: json!({"data": "abc", "views": 1}),
        setup: "toy".into(),
    }
}

fn coordinator(address: &str, expected: usize) -> Coordinator {
    let limits = Limits {
        greeting: Duration::from_millis(300),
        patience: Duration::from_millis(300),
        ..Limits::default()
    };
    Coordinator::listen(address, offer(), (1, expected), limits).unwrap()
}

fn worker(address: SocketAddr) -> Worker {
    Worker {
        address: address.to_string(),
        version: "1".into(),
        threads: 1,
        data: offer().data,
        wait: Duration::from_secs(20),
    }
}

/// A worker in a thread, with the number of batches that it has computed.
fn start(worker: Worker, factor: f32) -> (JoinHandle<Result<RunEnd>>, Arc<AtomicUsize>) {
    let computed = Arc::new(AtomicUsize::new(0));
    let mut toy = Toy {
        factor,
        computed: Arc::clone(&computed),
    };
    let run = move || {
        let stop = Stop::default();
        loop {
            let accepted = worker.join(&stop)?.unwrap();
            assert_eq!(accepted.setup, "toy");
            if let Some(end) = accepted.work(&mut toy, &stop)? {
                return Ok(end);
            }
        }
    };
    (std::thread::spawn(run), computed)
}

/// Takes a step, and compares it with that of one process.
fn step(coordinator: &Coordinator, step: u64) {
    let weights_now = weights(step);
    let compute = |tree: &GradientTree, batches: Range<usize>| {
        for batch in batches {
            // Much slower than a worker, so that it gets a share.
            std::thread::sleep(Duration::from_millis(3));
            tree.add_leaf(batch, leaf(step, batch, &weights_now));
        }
        Ok(())
    };
    let tree = coordinator.step((step, COUNT), || Ok(weights(step)), &compute);
    assert_eq!(tree.unwrap().into_root().unwrap(), alone(step));
}

/// Takes steps until `is_done`; returns the notices.
fn steps_until(coordinator: &Coordinator, mut is_done: impl FnMut(&[String]) -> bool) -> String {
    let begun = Instant::now();
    let mut notices = Vec::new();
    for index in 0.. {
        step(coordinator, index);
        notices.extend(coordinator.take_notices());
        if is_done(&notices) {
            break;
        }
        let waited = begun.elapsed();
        assert!(waited < Duration::from_secs(60), "{notices:?}");
    }
    notices.join("\n")
}

fn has(text: &str) -> impl FnMut(&[String]) -> bool {
    move |notices| notices.iter().any(|notice| notice.contains(text))
}

#[test]
fn step_has_the_same_bytes_for_any_number_of_workers() {
    let coordinator = coordinator("127.0.0.1:0", 2);
    step(&coordinator, 7);
    let workers = [(); 2].map(|()| start(worker(coordinator.address()), 1.0));
    coordinator.wait_for_workers(&Stop::default());
    let enough = |_: &[String]| {
        let counts = workers.iter().map(|(_, computed)| computed);
        counts
            .into_iter()
            .all(|count| count.load(Ordering::SeqCst) > 10)
    };
    steps_until(&coordinator, enough);
    coordinator.end(EndState::Finished);
    for (worker, _) in workers {
        assert_eq!(worker.join().unwrap().unwrap(), RunEnd::Finished);
    }
}

/// A worker that obeys the protocol by hand.
fn raw_worker(address: SocketAddr) -> Connection {
    let connection = Connection::new(TcpStream::connect(address).unwrap()).unwrap();
    let mut stream = connection.within(Duration::from_secs(20));
    write_magic(&mut stream).unwrap();
    let Offer { version, data, .. } = offer();
    let threads = 1;
    let hello = Message::Hello {
        version,
        threads,
        data,
    };
    write_message(&mut stream, &hello).unwrap();
    read_magic(&mut stream).unwrap();
    let welcome = read_message(&mut stream).unwrap();
    assert!(matches!(welcome, Message::Welcome { .. }), "{welcome:?}");
    connection
}

/// The next job of a worker.
fn next_job(connection: &Connection) -> (Part, Vec<Vec<f32>>) {
    let mut stream = connection.within(Duration::from_secs(20));
    loop {
        let header = read_header(&mut stream).unwrap();
        if header.kind == Kind::Job {
            return read_job(&mut stream, header, &SIZES).unwrap();
        }
        read_message_body(&mut stream, header).unwrap();
    }
}

/// Computes the trial, then receives a share.
fn take_share(connection: &Connection) -> Part {
    let mut toy = Toy {
        factor: 1.0,
        computed: Arc::default(),
    };
    let (part, weights) = next_job(connection);
    let sums = toy.sums(part.step, part.batches.clone(), &weights).unwrap();
    let mut stream = connection.within(Duration::from_secs(20));
    write_sums(&mut stream, &part, (0.0, &sums)).unwrap();
    next_job(connection).0
}

#[test]
fn lost_and_stalled_workers_change_nothing() {
    let coordinator = coordinator("127.0.0.1:0", 0);
    let address = coordinator.address();
    let closing = std::thread::spawn(move || take_share(&raw_worker(address)));
    let notices = steps_until(&coordinator, has("is lost"));
    assert!(notices.contains("it closed the connection"), "{notices}");
    closing.join().unwrap();

    // It keeps the connection until the coordinator ends it.
    let stalled = std::thread::spawn(move || {
        let connection = raw_worker(address);
        take_share(&connection);
        let mut rest = Vec::new();
        let mut stream = connection.within(Duration::from_secs(20));
        stream.read_to_end(&mut rest).map(|_| rest)
    });
    let notices = steps_until(&coordinator, has("is lost"));
    assert!(notices.contains("did not answer in time"), "{notices}");
    assert_eq!(stalled.join().unwrap().unwrap(), b"");

    let lying = std::thread::spawn(move || {
        let connection = raw_worker(address);
        take_share(&connection);
        let mut stream = connection.within(Duration::from_secs(20));
        let huge = [&[3][..], &u64::MAX.to_le_bytes()].concat();
        stream.write_all(&huge).unwrap();
    });
    let notices = steps_until(&coordinator, has("is lost"));
    assert!(
        notices.contains("received 18446744073709551615"),
        "{notices}"
    );
    lying.join().unwrap();

    let failing = std::thread::spawn(move || {
        let connection = raw_worker(address);
        take_share(&connection);
        let reason = "no \u{1b}[31mframes".to_owned();
        let mut stream = connection.within(Duration::from_secs(20));
        write_message(&mut stream, &Message::Failed { reason }).unwrap();
    });
    let notices = steps_until(&coordinator, has("failed: no [31mframes"));
    assert!(notices.contains("joined: 1 worker"), "{notices}");
    failing.join().unwrap();

    // Another may join.
    let (next, computed) = start(worker(address), 1.0);
    steps_until(&coordinator, |_| computed.load(Ordering::SeqCst) > 3);
    drop(coordinator);
    let error = next.join().unwrap().unwrap_err().to_string();
    assert!(error.contains("ended with an error"), "{error}");
}

#[test]
fn strangers_are_refused() {
    let coordinator = coordinator("127.0.0.1:0", 0);
    let send = |bytes: &[u8]| {
        let mut stream = TcpStream::connect(coordinator.address()).unwrap();
        stream.write_all(bytes).unwrap();
        stream
    };
    let with_magic = |bytes: &[u8]| [&b"wmtrain\x01"[..], bytes].concat();
    let huge = [&[1][..], &u64::MAX.to_le_bytes()].concat();
    let ping = [&[1][..], &18_u64.to_le_bytes(), br#"{"message":"ping"}"#].concat();
    for (bytes, expected) in [
        (b"GET / HTTP/1.1\r\n\r\n".to_vec(), "received \"GET / HT\""),
        (with_magic(&huge), "at most 262144 bytes"),
        (with_magic(&[9; 20]), "kind of frame"),
        (with_magic(&ping), "is not `hello`"),
        // Silent.
        (b"wm".to_vec(), "in time"),
    ] {
        let _open = send(&bytes);
        let notices = steps_until(&coordinator, has("refused"));
        assert!(notices.contains(expected), "{notices}");
        assert!(notices.contains("from 127.0.0.1:") || notices.contains("at 127.0.0.1:"));
    }
}

#[test]
fn other_data_and_versions_are_named_on_both_sides() {
    let coordinator = coordinator("127.0.0.1:0", 0);
    let other = Worker {
        data: json!({"data": "xyz", "views": 1}),
        ..worker(coordinator.address())
    };
    let old = Worker {
        version: "0.9".into(),
        ..worker(coordinator.address())
    };
    for (refused, expected) in [
        (
            other,
            "data: \"abc\" of the coordinator, \"xyz\" of the worker",
        ),
        (old, "its version is 0.9, expected 1"),
    ] {
        let error = refused.join(&Stop::default()).map(|_| ()).unwrap_err();
        assert!(error.to_string().contains(expected), "{error}");
        let notices = steps_until(&coordinator, has(expected));
        assert!(!notices.contains("views"), "{notices}");
    }
}

#[test]
fn wrong_gradients_are_refused_and_rounding_is_noticed() {
    let coordinator = coordinator("127.0.0.1:0", 0);
    let (wrong, _) = start(worker(coordinator.address()), 1.5);
    steps_until(&coordinator, has("is refused: its gradient"));
    let error = wrong.join().unwrap().unwrap_err().to_string();
    assert!(error.contains("differs by 5"), "{error}");

    let (rounding, _) = start(worker(coordinator.address()), 1.0 + 1e-6);
    let begun = Instant::now();
    let mut notices = String::new();
    // Its bytes differ from those of one process, so they are not compared.
    while !notices.contains("rounds differently") && begun.elapsed().as_secs() < 60 {
        let compute = |tree: &GradientTree, batches: Range<usize>| {
            batches.for_each(|batch| tree.add_leaf(batch, leaf(0, batch, &weights(0))));
            Ok(())
        };
        let tree = coordinator.step((0, COUNT), || Ok(weights(0)), &compute);
        assert!(tree.unwrap().into_root().is_some());
        notices += &coordinator.take_notices().join("\n");
    }
    assert!(notices.contains("rounds differently"), "{notices}");
    coordinator.end(EndState::Stopped);
    assert_eq!(rounding.join().unwrap().unwrap(), RunEnd::Stopped);
}

#[test]
fn worker_waits_for_a_restarted_coordinator_only_for_a_while() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = listener.local_addr().unwrap();
    let (running, computed) = start(worker(address), 1.0);
    // A coordinator that dies after the greeting.
    let (stream, _) = listener.accept().unwrap();
    let dying = Connection::new(stream).unwrap();
    let mut stream = dying.within(Duration::from_secs(20));
    read_magic(&mut stream).unwrap();
    read_message(&mut stream).unwrap();
    write_magic(&mut stream).unwrap();
    let setup = "toy".to_owned();
    write_message(&mut stream, &Message::Welcome { setup }).unwrap();
    drop((listener, dying));

    let restarted = coordinator(&address.to_string(), 1);
    restarted.wait_for_workers(&Stop::default());
    steps_until(&restarted, |_| computed.load(Ordering::SeqCst) > 3);
    restarted.end(EndState::Finished);
    assert_eq!(running.join().unwrap().unwrap(), RunEnd::Finished);

    let impatient = Worker {
        wait: Duration::ZERO,
        ..worker(address)
    };
    let error = impatient.join(&Stop::default()).map(|_| ()).unwrap_err();
    assert!(error.to_string().contains("no coordinator at"), "{error}");
}

#[test]
fn stopped_worker_leaves() {
    let coordinator = coordinator("127.0.0.1:0", 1);
    let (address, stop) = (coordinator.address(), Stop::default());
    let of_worker = stop.clone();
    let leaving = std::thread::spawn(move || {
        let worker = worker(address);
        let accepted = worker.join(&of_worker).unwrap().unwrap();
        let mut toy = Toy {
            factor: 1.0,
            computed: Arc::default(),
        };
        accepted.work(&mut toy, &of_worker).unwrap()
    });
    coordinator.wait_for_workers(&Stop::default());
    stop.ask();
    assert_eq!(leaving.join().unwrap(), Some(RunEnd::Stopped));
    steps_until(&coordinator, has("left; the others"));
    // A stop ends the wait for workers, too.
    coordinator.wait_for_workers(&stop);
}
