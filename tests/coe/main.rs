//! The CoE client and the SII parser against simulated drives, by EtherCAT frames composed here: two
//! implementations that share nothing meet in bytes.
#![cfg(feature = "std")]
#![allow(missing_docs)]

mod boundaries;
#[path = "../common/datagrams.rs"]
mod datagrams;
mod golden;
mod habits;
mod information;
mod real_bytes;

use std::future::{Future, poll_fn};
use std::task::Poll;
use std::time::Duration;

use servocrab::coe::{
    AbortCode, Clock, DriveError, DriveId, Emergencies, LinkFault, MailboxClient, MailboxSettings,
    MailboxStatus, MailboxTransport, SdoHandle, obj,
};
use servocrab::drives;
use servocrab::pdo_map::{ConfigureError, Layout, configure, read_back};
use servocrab::sii::{Mailbox, Sii, SyncManagerUsage};
use servocrab_sim::{Device, personality};

use datagrams::{APRD, APWR, Wire};

/// A mailbox by frames; time passes with each look at the clock's sleepers.
struct Frames {
    wire: Wire,
    mailbox: Mailbox,
}

impl MailboxTransport for Frames {
    async fn write_message(&self, message: &[u8]) -> Result<bool, LinkFault> {
        let mut whole = message.to_vec();
        whole.resize(usize::from(self.mailbox.receive_length), 0);
        let (_, acted) = self
            .wire
            .datagram(APWR, self.mailbox.receive_offset, &whole);
        Ok(acted)
    }

    async fn read_message(&self, message: &mut [u8]) -> Result<bool, LinkFault> {
        let (data, acted) = self.wire.datagram(APRD, self.mailbox.send_offset, message);
        message.copy_from_slice(&data);
        Ok(acted)
    }

    async fn status(&self) -> Result<MailboxStatus, LinkFault> {
        let registers = self.wire.read(0x0800, 16);
        MailboxStatus::from_registers(&registers).ok_or(LinkFault::NotAnswered)
    }

    async fn request_repeat(&self, toggle: bool) -> Result<(), LinkFault> {
        self.wire.write(0x080E, &[0x01 | u8::from(toggle) << 1]);
        Ok(())
    }
}

/// Each poll of a sleeper moves the time on.
struct Ticks(Wire);

impl Clock for Ticks {
    fn now(&self) -> Duration {
        self.0.now()
    }

    async fn sleep_until(&self, time: Duration) {
        poll_fn(|context| {
            if self.now() >= time {
                return Poll::Ready(());
            }
            self.0.pass(Duration::from_micros(10));
            context.waker().wake_by_ref();
            Poll::Pending
        })
        .await;
    }
}

/// Runs `work` with a handle of the simulated AKD2G.
fn with_drive<R, F: Future<Output = R>>(work: impl FnOnce(Wire, SdoHandle, Emergencies) -> F) -> R {
    with_device(personality::akd2g(), work)
}

/// Runs `work` with a handle of this drive in PREOP.
fn with_device<R, F: Future<Output = R>>(
    device: Device,
    work: impl FnOnce(Wire, SdoHandle, Emergencies) -> F,
) -> R {
    with_settings(device, |_| {}, work)
}

/// The same with other settings than those by its SII.
fn with_settings<R, F: Future<Output = R>>(
    device: Device,
    change: impl FnOnce(&mut MailboxSettings),
    work: impl FnOnce(Wire, SdoHandle, Emergencies) -> F,
) -> R {
    let wire = Wire::new(device);
    let sii = Sii::parse(&wire.sii_image()).unwrap();
    let mailbox = sii.mailbox.unwrap();
    wire.pre_op(&mailbox);
    let id = DriveId {
        position: 0,
        name: sii.name().unwrap_or_default().to_owned(),
        identity: sii.identity,
    };
    let frames = Frames {
        wire: wire.clone(),
        mailbox,
    };
    let mut settings = MailboxSettings::of(&sii, &mailbox);
    change(&mut settings);
    let clock = Ticks(wire.clone());
    let (client, handle, emergencies) = MailboxClient::new(frames, clock, settings, id);
    smol::block_on(smol::future::or(work(wire, handle, emergencies), async {
        client.run().await;
        panic!("the client ended first");
    }))
}

async fn configured(handle: &SdoHandle) -> Result<Layout, ConfigureError> {
    let mapping = drives::akd2g().default_mapping().unwrap();
    configure(&mapping, handle).await
}

#[test]
fn the_simulated_drives_sii_is_understood() {
    let sii = Sii::parse(&Wire::new(personality::akd2g()).sii_image()).unwrap();
    assert!(drives::akd2g().matches(&sii.identity), "{}", sii.identity);
    assert!(sii.mailbox.unwrap().protocols.coe());
    let outputs = sii
        .sync_managers
        .iter()
        .find(|manager| manager.usage == SyncManagerUsage::Outputs)
        .unwrap();
    assert!(!outputs.triggers_watchdog(), "as in a real AKD's SII");
}

#[test]
fn identity_by_coe_and_by_sii_agree() {
    with_drive(async |_, handle, _| {
        let by_sii = handle.drive().identity;
        assert_eq!(handle.read(obj::VENDOR_ID).await?, by_sii.vendor);
        assert_eq!(handle.read(obj::PRODUCT_CODE).await?, by_sii.product);
        assert_eq!(handle.read(obj::REVISION_NUMBER).await?, by_sii.revision);
        Ok::<_, DriveError>(())
    })
    .unwrap();
}

#[test]
fn values_of_both_axes_are_written_and_read_back() {
    with_drive(async |_, handle, _| {
        for axis in [1, 2] {
            let window = obj::POSITION_WINDOW_TIME.axis(axis);
            handle.write(window, 10 + u16::from(axis)).await?;
        }
        assert_eq!(handle.read(obj::POSITION_WINDOW_TIME.axis(1)).await?, 11);
        assert_eq!(handle.read(obj::POSITION_WINDOW_TIME.axis(2)).await?, 12);
        Ok::<_, DriveError>(())
    })
    .unwrap();
}

#[test]
fn a_position_window_time_of_32_bits_is_refused_by_the_drive() {
    // Pitfall 34: the reason why the typed object has 16.
    with_drive(async |_, handle, _| {
        let result = handle.write_bytes(0x6068, 0, vec![10, 0, 0, 0]).await;
        let code = result.unwrap_err().error.abort_code();
        assert!(
            matches!(
                code,
                Some(AbortCode::LENGTH | AbortCode(0x0607_0012 | 0x0607_0013))
            ),
            "{code:?}"
        );
    });
}

#[test]
fn the_mapping_of_two_axes_is_taken_and_read_back() {
    with_drive(async |_, handle, _| {
        let layout = configured(&handle).await.unwrap();
        assert_eq!((layout.output_bytes(), layout.input_bytes()), (38, 22));
        let held = read_back(&handle).await.unwrap();
        assert_eq!(held, drives::akd2g().default_mapping().unwrap());
    });
}

#[test]
fn an_entry_written_without_zero_first_is_refused_by_the_drive() {
    // Pitfall 30: the reason for the plan's order.
    with_drive(async |_, handle, _| {
        configured(&handle).await.unwrap();
        let entry = 0x6040_0010u32.to_le_bytes().to_vec();
        let error = handle.write_bytes(0x1600, 1, entry).await.unwrap_err();
        assert!(error.error.abort_code().is_some(), "{error}");
    });
}

#[test]
fn an_emergency_between_any_two_writes_of_a_mapping_does_no_harm() {
    with_drive(async |wire, handle, emergencies| {
        let steps = drives::akd2g().default_mapping().unwrap().plan();
        for (count, step) in steps.steps().iter().enumerate() {
            wire.inject_emergency([count as u8; 5]);
            handle
                .write_bytes(
                    step.object.index,
                    step.object.subindex,
                    step.value().to_vec(),
                )
                .await
                .unwrap();
        }
        let seen = std::iter::from_fn(|| emergencies.try_next());
        let counts: Vec<_> = seen
            .map(|report| report.emergency().unwrap().emergency.data[0])
            .collect();
        let all: Vec<_> = (0..steps.steps().len() as u8).collect();
        assert_eq!(counts, all, "each delivered once, in order");
    });
}

#[test]
fn a_name_is_read_as_text() {
    with_drive(async |_, handle, _| {
        let name = handle.read(obj::DEVICE_NAME).await.unwrap();
        assert!(name.starts_with(b"AKD"), "{name:02X?}");
    });
}
