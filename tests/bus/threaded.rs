//! The bus loop on its own thread, in real time.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use servocrab::{Network, SetPoint, ds402::State, link::Wire};
use servocrab_sim::{AlState, Segment, personality};

use crate::rig::akd2g;

fn line() -> (Arc<Mutex<Segment>>, Wire) {
    let segment = Arc::new(Mutex::new(Segment::new().with(personality::akd2g())));
    let shared = Arc::clone(&segment);
    let wire = Wire::new(move |frame: &mut [u8], now| shared.lock().unwrap().process(frame, now));
    (segment, wire)
}

#[test]
fn a_network_runs_on_its_own_thread_and_ends_in_order() {
    let (segment, wire) = line();
    smol::block_on(async {
        let net = Network::builder()
            .link(wire)
            .watchdog(Duration::from_secs(2))
            .drive(0, akd2g())
            .start()
            .await
            .unwrap();
        let axis = net.axis("x").unwrap();
        axis.enable().await.unwrap();
        assert_eq!(axis.status().state, State::OperationEnabled);
        let mode = axis.profile_position().await.unwrap();
        let set_point = SetPoint::new()
            .velocity(1_000_000)
            .acceleration(10_000_000)
            .deceleration(10_000_000);
        let motion = mode.move_abs(1_000, set_point).await.unwrap();
        motion.done().await.unwrap();
        assert!(net.statistics().cycles > 10);
        net.shutdown().await.unwrap();
    });
    let segment = segment.lock().unwrap();
    assert_eq!(segment.devices()[0].al_state(), AlState::Init);
    assert_eq!(segment.axis(0, 0).unwrap().ledger().len(), 1);
}

#[test]
fn a_network_that_is_dropped_ends_its_thread_in_bounded_time() {
    let (segment, wire) = line();
    let net = smol::block_on(Network::builder().link(wire).drive(0, akd2g()).start()).unwrap();
    let started = Instant::now();
    drop(net);
    assert!(started.elapsed() < Duration::from_secs(5));
    assert_eq!(
        segment.lock().unwrap().devices()[0].al_state(),
        AlState::Init
    );
}

#[test]
fn when_a_start_is_given_up_its_link_is_free_again_and_the_drives_are_in_init() {
    let (segment, _) = line();
    // Each answer takes so long that the start is far from its end when the drive has reached PREOP.
    let slow = Duration::from_millis(200);
    let change = |slow| {
        let mut segment = segment.lock().unwrap();
        segment.device_mut(0).unwrap().set_mailbox_delay(slow);
    };
    change(slow);
    let (is_in_pre_op, in_pre_op) = smol::channel::bounded(1);
    let shared = Arc::clone(&segment);
    let wire = Wire::new(move |frame: &mut [u8], now| {
        let mut segment = shared.lock().unwrap();
        let comes_back = segment.process(frame, now);
        if segment.devices()[0].al_state() == AlState::PreOp {
            // Once is enough.
            let _ = is_in_pre_op.try_send(());
        }
        comes_back
    });
    let given_up = smol::block_on(smol::future::or(
        async {
            let starting = Network::builder().link(wire).drive(0, akd2g()).start();
            Some(starting.await.map(drop))
        },
        async {
            in_pre_op.recv().await.unwrap();
            None
        },
    ));
    assert!(given_up.is_none(), "{given_up:?}");
    assert_eq!(Arc::strong_count(&segment), 1, "the link is gone");
    let state = segment.lock().unwrap().devices()[0].al_state();
    assert_eq!(state, AlState::Init);
    change(Duration::ZERO);
    let shared = Arc::clone(&segment);
    let wire = Wire::new(move |frame: &mut [u8], now| shared.lock().unwrap().process(frame, now));
    smol::block_on(async {
        let net = Network::builder().link(wire).drive(0, akd2g()).start();
        net.await.unwrap().shutdown().await.unwrap();
    });
}
