//! The EEPROM of a device on a scanned line: images and aliases written, refused, in force, and what is left when the power goes.

use std::{
    sync::{Arc, Mutex, MutexGuard},
    time::Duration,
};

use servocrab::{
    Network, NetworkError,
    bus::{
        EepromAccessError, EepromContent, EepromError, EepromWritten, ImageKind, Line as Scanned,
    },
    coe::obj,
    link::Wire,
    sii::{SiiImage, SiiImageError},
};
use servocrab_sim::{Device, EepromReload, Segment, personality};

use crate::rig::{datagrams, is_write_to};

const MS: Duration = Duration::from_millis(1);
/// The place of the device that is written, between two others.
const AT: u16 = 1;

/// A line on which one network follows the other, each from the time on at which the one before has ended.
#[derive(Clone)]
struct Bench(Arc<Mutex<(Segment, Duration)>>);

impl Bench {
    fn new(device: Device) -> Self {
        let segment = Segment::new().with(personality::coupler()).with(device);
        let segment = segment.with(personality::generic());
        Self(Arc::new(Mutex::new((segment, Duration::ZERO))))
    }

    fn lock(&self) -> MutexGuard<'_, (Segment, Duration)> {
        self.0.lock().unwrap()
    }

    fn change(&self, change: impl FnOnce(&mut Device)) {
        change(self.lock().0.device_mut(AT.into()).unwrap());
    }

    /// A wire on which each frame is changed before the segment sees it, and the device is looked at after that.
    fn wire_with(
        &self,
        mut spoil: impl FnMut(&mut [u8]) + Send + 'static,
        mut after: impl FnMut(&mut Device, &mut [u8], Duration) + Send + 'static,
    ) -> Wire {
        let (bench, begin) = (self.clone(), self.lock().1);
        Wire::in_virtual_time(MS / 100, move |frame: &mut [u8], now| {
            spoil(frame);
            let mut sent = frame.to_vec();
            let (segment, time) = &mut *bench.lock();
            *time = begin + now;
            let returns = segment.process(frame, *time);
            after(segment.device_mut(AT.into()).unwrap(), &mut sent, *time);
            returns
        })
    }

    fn wire(&self) -> Wire {
        self.wire_with(|_| (), |_, _, _| ())
    }

    fn eeprom(&self) -> Vec<u8> {
        self.lock().0.device(AT.into()).unwrap().eeprom().to_vec()
    }

    fn image(&self) -> Result<SiiImage, SiiImageError> {
        SiiImage::new(self.eeprom())
    }

    fn cycle_power(&self) {
        let (segment, now) = &mut *self.lock();
        let device = segment.device_mut(AT.into()).unwrap();
        device.power_off();
        device.power_on(*now);
    }

    /// The alias that a scan shows, with all well.
    fn scanned_alias(&self) -> u16 {
        let scanned = scan(self.wire()).unwrap();
        let device = &scanned.devices()[usize::from(AT)];
        assert!(device.problem.is_none(), "{:?}", device.problem);
        device.alias
    }
}

fn scan(wire: Wire) -> Result<Scanned, NetworkError> {
    smol::block_on(Network::builder().link(wire).scan())
}

/// Reads what is there, and writes what is made of that.
fn write(
    wire: Wire,
    kind: ImageKind,
    image: impl FnOnce(&EepromContent) -> SiiImage,
) -> Result<EepromWritten, EepromAccessError> {
    let scanned = scan(wire).unwrap();
    smol::block_on(async {
        let before = scanned.read_eeprom(AT).await?;
        let image = image(&before);
        scanned.write_eeprom(&before, &image, kind).await
    })
}

/// The same with alias 7 and other bytes in five words, up to the last one.
fn changed(old: &[u8]) -> SiiImage {
    let mut bytes = old.to_vec();
    // Pulse length of SYNC, revision, mailbox of BOOT.
    for (word, value) in [(2, 0x0A0Au16), (12, 9), (13, 1), (0x14, 0x1000), (0x7FF, 1)] {
        bytes[2 * word..2 * word + 2].copy_from_slice(&value.to_le_bytes());
    }
    let sum = bytes[..14].iter().fold(0xFFu8, |crc, byte| {
        (0..8).fold(crc ^ byte, |crc, _| {
            if crc & 0x80 != 0 {
                crc << 1 ^ 7
            } else {
                crc << 1
            }
        })
    });
    bytes[14] = sum;
    SiiImage::new(bytes).unwrap().with_alias(7)
}

#[test]
fn an_alias_is_in_force_after_a_reload_where_the_device_takes_it_over_and_else_after_a_power_up() {
    for (reload, at_once) in [
        (EepromReload::WithAlias, 7),
        (EepromReload::WithoutAlias, 0),
        (EepromReload::Refused, 0),
    ] {
        let line = Bench::new(personality::generic());
        let before = line.eeprom();
        line.change(|device| {
            device.set_eeprom_reload(reload);
            device.set_sii_delay(MS);
            device.set_sii_write_delay(8 * MS);
        });
        let alias = |old: &EepromContent| old.image().unwrap().with_alias(7);
        let written = write(line.wire(), ImageKind::Same, alias).unwrap();
        assert_eq!((written.words, written.alias), (2, at_once), "{reload:?}");
        let after = line.eeprom();
        assert_eq!(line.image().unwrap().alias(), 7);
        // Nothing else was touched.
        assert_eq!(after[..8], before[..8]);
        assert_eq!(after[10..14], before[10..14]);
        assert_eq!(after[16..], before[16..]);
        line.cycle_power();
        assert_eq!(line.scanned_alias(), 7, "{reload:?}");
        // Once more: there is nothing to be written.
        let again = write(line.wire(), ImageKind::Same, |old| old.image().unwrap());
        assert_eq!(again.unwrap().words, 0);
    }
}

#[test]
fn an_eeprom_that_the_drives_processor_serves_is_given_the_time_that_it_needs() {
    let line = Bench::new(personality::akd2g());
    line.change(|device| {
        device.set_sii_delay(MS);
        device.set_sii_write_delay(900 * MS);
    });
    let written = write(line.wire(), ImageKind::Same, |old| changed(old.bytes())).unwrap();
    assert_eq!(written.words, 7);
    assert_eq!(line.image().unwrap().alias(), 7);
    line.cycle_power();
    assert_eq!(line.scanned_alias(), 7);
}

#[test]
fn an_eeprom_that_does_not_take_a_word_is_named_and_one_that_never_ends_too() {
    // The coupler's words take longer than any EEPROM needs.
    let line = Bench::new(personality::coupler());
    line.change(|device| device.set_sii_write_delay(10_000 * MS));
    let error = write(line.wire(), ImageKind::Same, |old| changed(old.bytes())).unwrap_err();
    let EepromAccessError::Write { position, error } = &error else {
        panic!("{error}");
    };
    assert_eq!(*position, AT);
    assert!(
        matches!(error, EepromError::Refused { word: 7, .. }),
        "{error}"
    );
    // A write-protected one: its words are as they were.
    let line = Bench::new(personality::coupler());
    let before = line.eeprom();
    let reads_instead = |frame: &mut [u8]| {
        for datagram in datagrams(frame) {
            if is_write_to(datagram, 0x0502) && datagram[11] == 0x02 {
                datagram[10..12].copy_from_slice(&[0, 1]);
            }
        }
    };
    let wire = line.wire_with(reads_instead, |_, _, _| ());
    let error = write(wire, ImageKind::Same, |old| changed(old.bytes())).unwrap_err();
    let EepromAccessError::Write { error, .. } = &error else {
        panic!("{error}");
    };
    assert!(
        matches!(error, EepromError::NotKept { word: 7, .. }),
        "{error}"
    );
    assert_eq!(line.eeprom(), before);
}

#[test]
fn nothing_is_written_of_another_kind_or_longer_or_while_an_axis_is_enabled() {
    let line = Bench::new(personality::generic());
    let before = line.eeprom();
    let other = || SiiImage::new(personality::sigma7().eeprom()).unwrap();
    let error = write(line.wire(), ImageKind::Same, |_| other()).unwrap_err();
    assert!(
        matches!(error, EepromAccessError::OtherKind { .. }),
        "{error}"
    );

    let forced = Bench::new(personality::generic());
    write(forced.wire(), ImageKind::Any, |_| other()).unwrap();
    assert_eq!(forced.image(), Ok(other()));

    let longer = |old: &EepromContent| {
        let mut bytes = old.bytes().to_vec();
        bytes[0x7C] = 0xFF;
        bytes.resize(2 * bytes.len(), 0xFF);
        SiiImage::new(bytes).unwrap()
    };
    let error = write(line.wire(), ImageKind::Same, longer).unwrap_err();
    assert!(
        matches!(error, EepromAccessError::TooLong { .. }),
        "{error}"
    );

    // What was read of another device.
    let old = smol::block_on(scan(line.wire()).unwrap().read_eeprom(AT)).unwrap();
    let image = old.image().unwrap().with_alias(7);
    let written = scan(forced.wire()).unwrap();
    let error = smol::block_on(written.write_eeprom(&old, &image, ImageKind::Same)).unwrap_err();
    assert!(
        matches!(error, EepromAccessError::OtherContent { .. }),
        "{error}"
    );
    assert_eq!(forced.image(), Ok(other()));

    let scanned = scan(line.wire()).unwrap();
    let error = smol::block_on(async {
        assert!(matches!(
            scanned.read_eeprom(3).await,
            Err(EepromAccessError::NoDevice { count: 3, .. })
        ));
        let before = scanned.read_eeprom(AT).await.unwrap();
        // An axis of another drive, which is enabled by messages.
        let sdo = scanned.devices()[2].sdo.clone().unwrap();
        for (word, state) in [(0x06, 0x21), (0x07, 0x23), (0x0F, 0x27)] {
            sdo.write(obj::CONTROLWORD, word).await.unwrap();
            while sdo.read(obj::STATUSWORD).await.unwrap() & 0x6F != state {}
        }
        let image = before.image().unwrap().with_alias(7);
        scanned
            .write_eeprom(&before, &image, ImageKind::Any)
            .await
            .unwrap_err()
    });
    assert!(
        matches!(error, EepromAccessError::Enabled { axis: 1, .. }),
        "{error}"
    );
    assert_eq!(line.eeprom(), before);
}

/// When the power goes: while the EEPROM is at work on a word, or when it has finished that.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Lost {
    Meanwhile,
    After,
}

/// The device is without power from the n-th word on that is written.
fn losing_power(bench: &Bench, nth: usize, lost: Lost) -> Wire {
    let (mut count, mut off_at) = (0, None);
    bench.wire_with(
        |_| (),
        move |device, frame, now| {
            for datagram in datagrams(frame) {
                if is_write_to(datagram, 0x0502) && datagram[10..12] == [0x01, 0x02] {
                    count += 1;
                    if count == nth {
                        let after = if lost == Lost::After {
                            DELAY + WRITE_DELAY
                        } else {
                            Duration::ZERO
                        };
                        off_at = Some(now + after);
                    }
                }
            }
            if off_at.is_some_and(|at| now >= at) {
                device.power_off();
            }
        },
    )
}

const DELAY: Duration = Duration::from_micros(500);
const WRITE_DELAY: Duration = Duration::from_millis(2);

#[test]
fn without_power_at_any_step_the_old_image_is_there_or_can_be_restored_and_the_write_repeated() {
    // The wrong checksum, six other words, the right checksum.
    const STEPS: usize = 8;
    use Lost::{After, Meanwhile};
    for make in [
        personality::generic as fn() -> Device,
        personality::akd2g,
        personality::coupler,
    ] {
        for (step, lost, left) in (1..=STEPS).flat_map(|step| {
            [Meanwhile, After].map(|lost| {
                let left = if (step, lost) == (STEPS, After) {
                    "new"
                } else {
                    "invalid"
                };
                (step, lost, left)
            })
        }) {
            let row = format!("step {step}, {lost:?}");
            let mut device = make();
            device.set_sii_delay(DELAY);
            device.set_sii_write_delay(WRITE_DELAY);
            let bench = Bench::new(device);
            let old = bench.image().unwrap();
            let new = changed(old.bytes());
            let ended = write(
                losing_power(&bench, step, lost),
                ImageKind::Same,
                |before| {
                    assert_eq!(before.image(), Ok(old.clone()));
                    new.clone()
                },
            );
            let error = ended.unwrap_err();
            assert!(
                matches!(error, EepromAccessError::Write { .. }),
                "{row}: {error}"
            );
            bench.cycle_power();
            // Nobody takes a part of an image for the whole.
            match bench.image() {
                Ok(there) => assert_eq!((left, &there), ("new", &new), "{row}"),
                Err(SiiImageError::Checksum { .. }) => assert_eq!(left, "invalid", "{row}"),
                Err(error) => panic!("{row}: {error}"),
            }
            // The old one, from what was kept, then the new one: by the position, since an invalid one says nothing of its device.
            for wanted in [&old, &new] {
                let repeated = write(bench.wire(), ImageKind::Same, |_| wanted.clone());
                assert!(repeated.is_ok(), "{row}: {repeated:?}");
                assert_eq!(bench.image().as_ref(), Ok(wanted), "{row}");
                bench.cycle_power();
                assert_eq!(bench.scanned_alias(), wanted.alias(), "{row}");
            }
        }
    }
}
