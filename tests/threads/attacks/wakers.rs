//! Wakers are code of the program, and it may do in them what it likes.

use std::{
    future::Future,
    pin::Pin,
    sync::{
        Arc, Condvar, Mutex,
        atomic::{AtomicBool, AtomicU32, Ordering::SeqCst},
        mpsc,
    },
    task::{Wake, Waker},
    thread,
};

use servocrab::{Network, SetPoint, coe::obj};
use servocrab_sim::AlState;

use super::{line, poll, started, until};

/// A waker that does something.
struct Calls<F: Fn() + Send + Sync + 'static>(F);

impl<F: Fn() + Send + Sync> Wake for Calls<F> {
    fn wake(self: Arc<Self>) {
        (self.0)();
    }
}

fn waker(what: impl Fn() + Send + Sync + 'static) -> Waker {
    Arc::new(Calls(what)).into()
}

type Waiting = Pin<Box<dyn Future<Output = ()> + Send>>;

/// A wait for the next cycle.
fn owned_wait(net: &Network) -> Waiting {
    let clock = net.clock();
    Box::pin(async move { drop(clock.next_cycle().await) })
}

/// The same, begun with this waker.
fn wait_for_a_cycle(net: &Network, waker: &Waker) -> Waiting {
    loop {
        let mut waiting = owned_wait(net);
        // On a busy machine a cycle may pass before it is looked at.
        if poll(&mut waiting, waker).is_pending() {
            return waiting;
        }
    }
}

#[test]
fn cycles_go_on_while_a_waker_blocks_and_it_is_told() {
    let (segment, net) = started();
    let gate = Arc::new((Mutex::new(false), Condvar::new()));
    let (entered, closed) = (Arc::new(AtomicBool::new(false)), Arc::clone(&gate));
    let is_blocked = Arc::clone(&entered);
    let blocking = waker(move || {
        is_blocked.store(true, SeqCst);
        let (open, changed) = &*closed;
        drop(changed.wait_while(open.lock().unwrap(), |open| !*open));
    });
    let waiting = wait_for_a_cycle(&net, &blocking);
    until("the waker was called", || entered.load(SeqCst));
    let before = net.statistics().cycles;
    until("the cycles go on", || {
        net.statistics().cycles >= before + 400
    });
    let told = net.statistics().wakes;
    assert!(told.slow == 1 && !told.longest.is_zero(), "{told:?}");
    let state = segment.lock().unwrap().devices()[0].al_state();
    assert_eq!(state, AlState::Op, "its watchdog did not trip");
    // Another one is woken once it has returned.
    let woken = Arc::new(AtomicBool::new(false));
    let wakes = Arc::clone(&woken);
    let other = waker(move || wakes.store(true, SeqCst));
    let other = wait_for_a_cycle(&net, &other);
    let before = net.statistics().cycles;
    until("the cycles go on", || {
        net.statistics().cycles >= before + 10
    });
    assert!(!woken.load(SeqCst));
    *gate.0.lock().unwrap() = true;
    gate.1.notify_all();
    until("it is woken", || woken.load(SeqCst));
    drop((waiting, other));
    smol::block_on(net.shutdown()).unwrap();
}

#[test]
fn a_waker_that_panics_ends_nothing_but_its_own_future() {
    let (segment, net) = started();
    let calls = Arc::new(AtomicU32::new(0));
    for n in 1..=3 {
        let called = Arc::clone(&calls);
        let panicking = waker(move || {
            called.fetch_add(1, SeqCst);
            panic!("a waker of the program, as this test wants it");
        });
        let waiting = wait_for_a_cycle(&net, &panicking);
        until("it was called", || calls.load(SeqCst) == n);
        drop(waiting);
    }
    smol::block_on(async {
        let axis = net.axis("x").unwrap();
        axis.enable().await.unwrap();
        let pp = axis.profile_position().await.unwrap();
        let set_point = SetPoint::new().velocity(1_000_000).acceleration(10_000_000);
        let set_point = set_point.deceleration(10_000_000);
        pp.move_abs(1_000, set_point)
            .await
            .unwrap()
            .done()
            .await
            .unwrap();
        assert_eq!(net.statistics().wakes.panicked, 3);
        net.shutdown().await.unwrap();
    });
    let segment = segment.lock().unwrap();
    assert_eq!(segment.devices()[0].al_state(), AlState::Init);
}

#[test]
fn a_waker_may_call_whatever_it_likes() {
    let (_, net) = started();
    let net = Arc::new(net);
    let axis = net.axis("x").unwrap();
    let (done, is_done) = mpsc::channel();
    let kept = Mutex::new(None);
    let (net_of, axis_of) = (Arc::clone(&net), axis.clone());
    let calling = waker(move || {
        let net = &net_of;
        axis_of.stop_handle().quick_stop();
        let status = axis_of.status();
        drop(axis_of.clone());
        // A wait of its own, which is never polled again.
        let mut asked = owned_wait(net);
        let _ = poll(&mut asked, Waker::noop());
        *kept.lock().unwrap() = Some(asked);
        net.stop_all(servocrab::StopRequest::HALT);
        let _ = done.send((status.cycle, net.statistics().cycles));
    });
    let waiting = wait_for_a_cycle(&net, &calling);
    is_done.recv().unwrap();
    drop((waiting, calling));
    smol::block_on(async {
        let sdo = net.sdo(0).unwrap();
        sdo.read(obj::ERROR_CODE).await.unwrap();
        // Its stop has been taken in.
        net.clock().next_cycle().await.unwrap();
        net.clock().next_cycle().await.unwrap();
        axis.enable().await.unwrap();
        net.shutdown().await.unwrap();
    });
}

#[test]
fn a_waker_may_drop_the_last_network() {
    let (segment, net) = started();
    let axis = net.axis("x").unwrap();
    smol::block_on(axis.enable()).unwrap();
    let clock = net.clock();
    let last = Mutex::new(Some(net));
    let dropping = waker(move || drop(last.lock().unwrap().take()));
    let mut waiting = Box::pin(async move { clock.next_cycle().await });
    assert!(poll(&mut waiting, &dropping).is_pending());
    // Another task hears of the end.
    smol::block_on(async { while axis.changed().await.is_some() {} });
    until("the drives are in INIT", || {
        segment.lock().unwrap().devices()[0].al_state() == AlState::Init
    });
}

/// Says on which threads it was woken and dropped.
struct Witness(Arc<Mutex<Vec<String>>>);

impl Witness {
    fn note(&self, what: &str) {
        let thread = thread::current();
        let name = thread.name().unwrap_or("?");
        self.0.lock().unwrap().push(format!("{what} on {name}"));
    }
}

impl Wake for Witness {
    fn wake(self: Arc<Self>) {
        self.note("woken");
    }
}

impl Drop for Witness {
    fn drop(&mut self) {
        self.note("dropped");
    }
}

#[test]
fn no_waker_is_woken_or_dropped_on_the_bus_thread() {
    let seen = Arc::new(Mutex::new(Vec::new()));
    let waker = || Waker::from(Arc::new(Witness(Arc::clone(&seen))));
    /// As an executor does, with another waker at every poll.
    fn finish<T>(future: impl Future<Output = T>, waker: &dyn Fn() -> Waker) -> T {
        let mut future = Box::pin(future);
        let mut value = None;
        until("it is ready", || match poll(&mut future, &waker()) {
            std::task::Poll::Ready(ready) => {
                value = Some(ready);
                true
            }
            std::task::Poll::Pending => false,
        });
        value.unwrap()
    }
    let (segment, builder) = line();
    let net = finish(builder.start(), &waker).unwrap();
    let axis = net.axis("x").unwrap();
    let (events, emergencies) = (net.events(), net.all_emergencies());
    let mut kept: Vec<Pin<Box<dyn Future<Output = ()>>>> = vec![
        Box::pin(async { drop(events.next().await) }),
        Box::pin(async { drop(emergencies.next().await) }),
        Box::pin(async { assert!(axis.changed().await.is_some()) }),
        Box::pin(async { drop(net.clock().sleep(super::NEVER).await) }),
    ];
    for future in &mut kept {
        assert!(poll(future, &waker()).is_pending());
    }
    // One that is never dropped leaves its waker behind.
    let mut forgotten = owned_wait(&net);
    assert!(poll(&mut forgotten, &waker()).is_pending());
    std::mem::forget(forgotten);
    finish(axis.enable(), &waker).unwrap();
    let pp = finish(axis.profile_position(), &waker).unwrap();
    let motion = finish(
        pp.move_abs(1_000, SetPoint::new().velocity(100_000)),
        &waker,
    )
    .unwrap();
    finish(motion.done(), &waker).unwrap();
    let sdo = net.sdo(0).unwrap();
    for _ in 0..5 {
        finish(sdo.read(obj::ERROR_CODE), &waker).unwrap();
    }
    finish(net.black_box("x"), &waker).unwrap();
    finish(net.port_errors(), &waker).unwrap();
    finish(net.clock().next_cycle(), &waker).unwrap();
    segment
        .lock()
        .unwrap()
        .axis_mut(0, 0)
        .unwrap()
        .inject_fault(0x8611);
    finish(emergencies.next(), &waker).unwrap();
    finish(events.next(), &waker).unwrap();
    finish(axis.reset_fault(), &waker).unwrap();
    finish(net.recover(0), &waker).unwrap();
    finish(net.shutdown(), &waker).unwrap();
    drop(kept);
    let seen = seen.lock().unwrap();
    let on = |thread: &str| seen.iter().filter(|line| line.ends_with(thread)).count();
    assert!(on("servocrab-wake") > 10, "{seen:?}");
    assert_eq!(on("servocrab-bus"), 0, "{seen:?}");
}
