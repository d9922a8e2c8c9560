use std::{
    collections::BTreeMap,
    io::ErrorKind,
    net::{SocketAddr, TcpListener},
    ops::Range,
    sync::{
        Arc, Mutex, PoisonError,
        mpsc::{self, Sender, TryRecvError},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result};

use super::{
    frame::Part,
    limits::Limits,
    message::EndState,
    order::{Job, Offer, Order, Reply},
    peer,
    roster::{Entry, Roster, plural},
    shares::{Measurement, Pace, shares},
    trial::{Trial, Verdict, verdict},
};
use crate::{
    gradient_tree::{GradientTree, Node, covering},
    run::Stop,
};

/// Pause of the accepting thread without connections.
const ACCEPT_PAUSE: Duration = Duration::from_millis(50);
/// Steps after which a worker without a share is tried again: it may have become faster.
const IDLE_STEPS: u32 = 50;

/// Computes batches of the present step in this process, and adds them to the tree.
pub type Compute<'a> = dyn Fn(&GradientTree, Range<usize>) -> Result<()> + 'a;

/// Shares the batches of each step among this process and the workers that have joined.
#[derive(Debug)]
pub struct Coordinator {
    roster: Arc<Roster>,
    address: SocketAddr,
    /// Workers to wait for before the first step.
    expected: usize,
    own: Mutex<Own>,
    accepting: Option<JoinHandle<()>>,
}

/// Speed of this process.
#[derive(Debug)]
struct Own {
    threads: usize,
    /// `None` before its first batch.
    pace: Option<Pace>,
}

impl Coordinator {
    /// Listens for workers at `address`, which may be a host name. This process computes with `threads` threads.
    ///
    /// # Errors
    /// If the address cannot be used.
    pub fn listen(
        address: &str,
        offer: Offer,
        (threads, expected): (usize, usize),
        limits: Limits,
    ) -> Result<Self> {
        let listen = || {
            let listener = TcpListener::bind(address)?;
            // A blocked thread could not end.
            listener.set_nonblocking(true)?;
            Ok::<_, std::io::Error>((listener.local_addr()?, listener))
        };
        let (address, listener) = listen().with_context(|| format!("--listen {address}"))?;
        let roster = Arc::new(Roster::new(offer, limits));
        let for_thread = Arc::clone(&roster);
        let accepting = std::thread::Builder::new()
            .name("accept workers".to_owned())
            .spawn(move || accept(&listener, &for_thread))?;
        Ok(Self {
            roster,
            address,
            expected,
            own: Mutex::new(Own {
                threads,
                pace: None,
            }),
            accepting: Some(accepting),
        })
    }

    /// Its address.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Waits until the expected workers have joined, or `stop` is set.
    pub fn wait_for_workers(&self, stop: &Stop) {
        if self.expected > 0 {
            println!("waiting for {}", plural(self.expected, "worker"));
        }
        // Short enough for a stop.
        let check = Duration::from_millis(100);
        let mut count = 0;
        while count < self.expected && !stop.is_asked() {
            count = self.roster.wait(check);
            self.take_notices()
                .iter()
                .for_each(|notice| println!("{notice}"));
        }
    }

    /// Notices about workers since the last call.
    pub fn take_notices(&self) -> Vec<String> {
        self.roster.take_notices()
    }

    /// The sums of the `count` batches of step `step`, computed with `weights` by this process and the workers. Batches
    /// that a worker does not return in time are computed here.
    ///
    /// # Errors
    /// Those of `weights` and `compute`.
    pub fn step(
        &self,
        (step, count): (u64, usize),
        weights: impl FnOnce() -> Result<Vec<Vec<f32>>>,
        compute: &Compute<'_>,
    ) -> Result<GradientTree> {
        let tree = GradientTree::new(count);
        self.finish_trials();
        if self.roster.with_workers(|workers| workers.is_empty()) {
            self.compute_own(&tree, 0..count, compute)?;
            return Ok(tree);
        }
        let weights = Arc::new(weights()?);
        let job = |batches: Range<usize>, limit, reply| Job {
            places: covering(batches.clone(), count),
            part: Part { step, batches },
            weights: Arc::clone(&weights),
            limit,
            is_share: true,
            reply,
        };
        self.begin_trials(count, &job, compute)?;

        let (reply, replies) = mpsc::channel();
        let (own, mut open) = self.send_jobs(count, &job, &reply);
        // The channel closes when the last job has ended.
        drop(reply);
        self.compute_own(&tree, own, compute)?;
        for reply in replies {
            if open.remove(&reply.worker).is_some() {
                self.measure(&reply);
                reply.nodes.into_iter().for_each(|node| tree.add(node));
            }
        }
        for batches in open.into_values() {
            self.compute_own(&tree, batches, compute)?;
        }
        Ok(tree)
    }

    /// Sends the shares of the workers. Returns the own share, and theirs by worker.
    fn send_jobs(
        &self,
        count: usize,
        job: &impl Fn(Range<usize>, Duration, Sender<Reply>) -> Job,
        reply: &Sender<Reply>,
    ) -> (Range<usize>, BTreeMap<u64, Range<usize>>) {
        let own = self.own_pace();
        let patience = self.roster.limits.patience;
        self.roster.with_workers(|workers| {
            let free = workers
                .iter_mut()
                .filter(|(_, entry)| entry.trial.is_none());
            let mut free: Vec<(u64, Pace, &mut Entry)> = free
                .filter_map(|(key, entry)| Some((*key, entry.pace?, entry)))
                .collect();
            let paces = free.iter().map(|(_, pace, _)| *pace);
            // Without an own measurement, there is no worker with one.
            let own = own.unwrap_or(Pace {
                threads: 1,
                round: 1.0,
                transfer: 0.0,
            });
            let paces: Vec<Pace> = [own].into_iter().chain(paces).collect();
            let mut ranges = shares(count, &paces).into_iter();
            let own = ranges.next().unwrap_or(0..count);
            let (mut open, mut ended) = (BTreeMap::new(), Vec::new());
            for ((key, pace, entry), batches) in free.iter_mut().zip(ranges) {
                entry.idle_steps += 1;
                if batches.is_empty() {
                    continue;
                }
                entry.idle_steps = 0;
                open.insert(*key, batches.clone());
                let expected = Duration::from_secs_f64(pace.time(batches.len()).min(1e6));
                let job = job(batches, patience + 3 * expected, reply.clone());
                // The batches of an ended thread are computed here.
                if !entry.order(Order::Compute(job)) {
                    ended.push(*key);
                }
            }
            for worker in ended {
                workers.remove(&worker);
            }
            (own, open)
        })
    }

    fn own_pace(&self) -> Option<Pace> {
        self.own.lock().unwrap_or_else(PoisonError::into_inner).pace
    }

    fn compute_own(
        &self,
        tree: &GradientTree,
        batches: Range<usize>,
        compute: &Compute<'_>,
    ) -> Result<()> {
        if batches.is_empty() {
            return Ok(());
        }
        let (begun, count) = (Instant::now(), batches.len());
        compute(tree, batches)?;
        let measured = Measurement {
            batches: count,
            computation: begun.elapsed().as_secs_f64(),
            transfer: 0.0,
        };
        let mut own = self.own.lock().unwrap_or_else(PoisonError::into_inner);
        let first = Pace::first(own.threads, measured);
        own.pace = Some(own.pace.map_or(first, |pace| pace.and(measured)));
        Ok(())
    }

    fn measure(&self, reply: &Reply) {
        self.roster.with_workers(|workers| {
            if let Some(entry) = workers.get_mut(&reply.worker) {
                entry.pace = entry.pace.map(|pace| pace.and(reply.measured));
            }
        });
    }

    /// Begins the trials of new and of long idle workers, for which nothing waits.
    fn begin_trials(
        &self,
        count: usize,
        job: &impl Fn(Range<usize>, Duration, Sender<Reply>) -> Job,
        compute: &Compute<'_>,
    ) -> Result<()> {
        let is_due = |entry: &Entry| {
            entry.trial.is_none() && (entry.pace.is_none() || entry.idle_steps >= IDLE_STEPS)
        };
        if !(self.roster).with_workers(|workers| workers.values().any(is_due)) {
            return Ok(());
        }
        let tree = GradientTree::new(count);
        self.compute_own(&tree, 0..1, compute)?;
        let node = tree.into_nodes().pop().context("a step without batches")?;
        let reference = Arc::new(node);
        self.roster.with_workers(|workers| {
            for entry in workers.values_mut().filter(|entry| is_due(entry)) {
                let (sender, reply) = mpsc::channel();
                entry.trial = Some(Trial {
                    reference: Arc::clone(&reference),
                    reply,
                });
                let job = job(0..1, self.roster.limits.trial, sender);
                let is_share = false;
                entry.order(Order::Compute(Job { is_share, ..job }));
            }
        });
        Ok(())
    }

    /// Judges the workers whose trials have ended.
    fn finish_trials(&self) {
        let mut notices = Vec::new();
        self.roster.with_workers(|workers| {
            for entry in workers.values_mut() {
                let Some(trial) = entry.trial.take() else {
                    continue;
                };
                match trial.reply.try_recv() {
                    Ok(reply) => notices.extend(entry.judge(&trial.reference, &reply)),
                    Err(TryRecvError::Empty) => entry.trial = Some(trial),
                    // A lost worker removes itself.
                    Err(TryRecvError::Disconnected) => {}
                }
            }
        });
        for notice in notices {
            self.roster.notice(notice);
        }
    }

    /// Ends the training for all workers.
    pub fn end(self, state: EndState) {
        self.roster.close(state, self.roster.limits.farewell);
    }
}

impl Drop for Coordinator {
    fn drop(&mut self) {
        // Without effect after `end`.
        let roster = &self.roster;
        roster.close(EndState::Failed, roster.limits.farewell);
        if let Some(accepting) = self.accepting.take() {
            // A panic has been printed.
            accepting.join().ok();
        }
    }
}

impl Entry {
    /// Sends an order to its thread; `false` if that has ended, which drops the order with its reply.
    fn order(&self, order: Order) -> bool {
        let orders = self.orders.as_ref();
        orders.is_some_and(|orders| orders.try_send(order).is_ok())
    }

    /// Compares the result of a trial; returns a notice of other rounding.
    fn judge(&mut self, reference: &Node, reply: &Reply) -> Option<String> {
        let found = reply.nodes.first()?;
        let address = self.address;
        match verdict(reference, found)? {
            Verdict::Wrong(error) => {
                self.pace = None;
                self.order(Order::Refuse(format!(
                    "its gradient of a trial batch differs by {error:.1e}; use the same build, and the same data"
                )));
                return None;
            }
            Verdict::Exact => self.take_pace(reply),
            Verdict::Rounded(error) => {
                self.take_pace(reply);
                if !std::mem::replace(&mut self.is_rounding_known, true) {
                    return Some(format!(
                        "worker {address} rounds differently (relative difference {error:.0e}), as other processors do: \
                         the bytes of the model depend on the shares"
                    ));
                }
            }
        }
        None
    }

    fn take_pace(&mut self, reply: &Reply) {
        self.idle_steps = 0;
        self.pace = Some(Pace::first(self.threads, reply.measured));
    }
}

/// Accepts connections until the training ends, each with a thread.
fn accept(listener: &TcpListener, roster: &Arc<Roster>) {
    while roster.end().is_none() {
        let (stream, address) = match listener.accept() {
            Ok(accepted) => accepted,
            Err(error) => {
                if error.kind() != ErrorKind::WouldBlock {
                    tracing::debug!("a connection cannot be accepted: {error}");
                }
                std::thread::sleep(ACCEPT_PAUSE);
                continue;
            }
        };
        if !roster.admit() {
            roster.notice(format!(
                "refused a connection from {address}: too many connections"
            ));
            continue;
        }
        let for_thread = Arc::clone(roster);
        let spawned = std::thread::Builder::new()
            .name(format!("worker {address}"))
            .spawn(move || {
                peer::serve(&for_thread, stream, address);
                for_thread.dismiss();
            });
        if let Err(error) = spawned {
            roster.dismiss();
            roster.notice(format!("refused a connection from {address}: {error}"));
        }
    }
}
