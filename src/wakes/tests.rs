use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Condvar, Mutex};
use std::task::{Context, Poll, Wake, Waker};
use std::thread;

use smol::future::poll_once;

use super::*;

/// Counts how often it was woken, and does something then.
struct Woken<F: Fn() + Send + Sync>(AtomicU32, F);

impl<F: Fn() + Send + Sync> Wake for Woken<F> {
    fn wake(self: Arc<Self>) {
        self.0.fetch_add(1, Ordering::AcqRel);
        (self.1)();
    }
}

fn woken<F: Fn() + Send + Sync>(what: F) -> Arc<Woken<F>> {
    Arc::new(Woken(AtomicU32::new(0), what))
}

#[test]
fn a_future_is_polled_again_only_when_its_channel_was_rung_and_handed_over() {
    let (wakes, _end) = Wakes::in_turn();
    let waiters = wakes.waiters();
    let futures: [_; 200] = std::array::from_fn(|n| {
        let ready = || None::<()>;
        (woken(|| ()), Box::pin(waiters.until(n as u32 % 2, ready)))
    });
    let mut futures = futures;
    let mut poll_all = |wanted: u32| {
        for (n, (woken, future)) in futures.iter_mut().enumerate() {
            let waker = Waker::from(Arc::clone(woken) as Arc<_>);
            assert!(
                future
                    .as_mut()
                    .poll(&mut Context::from_waker(&waker))
                    .is_pending()
            );
            let times = woken.0.swap(0, Ordering::AcqRel);
            assert_eq!(times, if n % 2 == 1 { wanted } else { 0 });
        }
    };
    poll_all(0);
    wakes.hand_over();
    poll_all(0);
    for _ in 0..3 {
        waiters.announce(1);
    }
    poll_all(0);
    waiters.announce(1);
    wakes.hand_over();
    wakes.hand_over();
    poll_all(1);
    drop(futures);
    waiters.announce(0);
    wakes.hand_over();
}

#[test]
fn whoever_waits_is_woken_by_the_end_and_whoever_rings_after_it_wakes() {
    for in_turn in [true, false] {
        let (wakes, end) = if in_turn {
            Wakes::in_turn()
        } else {
            Wakes::start(None).unwrap()
        };
        let waiters = wakes.waiters();
        let (sender, receiver) = smol::channel::bounded(1);
        let waiting = Arc::clone(&waiters);
        let task = thread::spawn(move || {
            smol::block_on(async {
                waiting.relay(receiver.recv()).await.unwrap();
                waiting.relay(receiver.recv()).await.unwrap();
            });
        });
        sender.send_blocking(()).unwrap();
        drop(end);
        sender.send_blocking(()).unwrap();
        task.join().unwrap();
        drop(waiters);
    }
}

#[test]
fn a_waker_that_blocks_is_told_while_it_blocks_and_one_that_panics_costs_its_own_future() {
    let (wakes, _end) = Wakes::start(None).unwrap();
    let waiters = wakes.waiters();
    let gate = Arc::new((Mutex::new(false), Condvar::new()));
    let closed = Arc::clone(&gate);
    let panicking = woken(|| panic!("as a test wants it"));
    let blocking = woken(move || {
        let (open, changed) = &*closed;
        drop(changed.wait_while(open.lock().unwrap(), |open| !*open));
    });
    let last = woken(|| ());
    let mut futures = [0, 1, 2].map(|channel| Box::pin(waiters.until(channel, || None::<()>)));
    let wakers: [Waker; 3] = [panicking.into(), blocking.into(), Arc::clone(&last).into()];
    for (future, waker) in futures.iter_mut().zip(&wakers) {
        let polled = future.as_mut().poll(&mut Context::from_waker(waker));
        assert_eq!(polled, Poll::Pending);
    }
    for channel in 0..3 {
        waiters.announce(channel);
    }
    wakes.hand_over();
    while wakes.statistics().slow == 0 {
        thread::yield_now();
    }
    assert_eq!(last.0.load(Ordering::Acquire), 0);
    assert!(wakes.statistics().longest > SLOW);
    *gate.0.lock().unwrap() = true;
    gate.1.notify_all();
    while last.0.load(Ordering::Acquire) == 0 {
        thread::yield_now();
    }
    let told = wakes.statistics();
    assert_eq!((told.slow, told.panicked), (1, 1));
}

#[test]
fn futures_of_several_threads_lose_no_ring() {
    let (wakes, _end) = Wakes::start(None).unwrap();
    let waiters = wakes.waiters();
    let value = Arc::new(AtomicU32::new(0));
    let threads: Vec<_> = (0..5)
        .map(|channel| {
            let (waiters, value) = (Arc::clone(&waiters), Arc::clone(&value));
            thread::spawn(move || {
                for wanted in 1..=200 {
                    let ready = || (value.load(Ordering::Acquire) >= wanted).then_some(());
                    smol::block_on(waiters.until(channel % 2, ready));
                }
            })
        })
        .collect();
    for n in 1..=200 {
        value.store(n, Ordering::Release);
        stored();
        waiters.ring(0);
        waiters.ring(1);
        wakes.hand_over();
        thread::yield_now();
    }
    for thread in threads {
        thread.join().unwrap();
    }
}

#[test]
fn a_task_of_the_bus_is_woken_by_what_it_waits_for_itself() {
    let (wakes, _end) = Wakes::in_turn();
    let waiters = wakes.waiters();
    let (sender, receiver) = smol::channel::bounded(1);
    let mut future = Box::pin(waiters.relay(receiver.recv()));
    let direct = woken(|| ());
    let waker = Waker::from(Arc::clone(&direct) as Arc<_>);
    on_bus(|| {
        let polled = future.as_mut().poll(&mut Context::from_waker(&waker));
        assert!(polled.is_pending());
    });
    sender.try_send(()).unwrap();
    assert_eq!(
        direct.0.load(Ordering::Acquire),
        1,
        "nothing was handed over"
    );
    assert_eq!(smol::block_on(poll_once(future)), Some(Ok(())));
}
