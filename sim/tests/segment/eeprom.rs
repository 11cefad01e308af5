//! The EEPROM behind 0500h to 050Fh: words written, the time that they need, the reload, and what is there after a loss of power.

use core::time::Duration;

use servocrab_sim::{Device, EepromReload, Segment, personality};

use super::master::{APWR, Master};

const STATION: u16 = 0x1001;
const MS: Duration = Duration::from_millis(1);
const READ: u16 = 0x0100;
const WRITE: u16 = 0x0201;
const RELOAD: u16 = 0x0400;

fn master_of(device: Device) -> Master {
    let mut master = Master::new(Segment::new().with(device));
    assert_eq!(
        master.exchange(APWR, 0, 0x0010, &STATION.to_le_bytes()).1,
        1
    );
    master
}

fn device(master: &mut Master) -> &mut Device {
    master.segment.device_mut(0).unwrap()
}

fn status(master: &mut Master) -> u16 {
    u16::from_le_bytes(master.read::<2>(STATION, 0x0502))
}

fn alias(master: &mut Master) -> u16 {
    u16::from_le_bytes(master.read::<2>(STATION, 0x0012))
}

fn command(master: &mut Master, command: u16, word: u8) {
    let [c0, c1] = command.to_le_bytes();
    master.write(STATION, 0x0502, &[c0, c1, word, 0, 0, 0]);
}

fn write(master: &mut Master, word: u8, value: u16) {
    master.write(STATION, 0x0508, &value.to_le_bytes());
    command(master, WRITE, word);
}

fn word(master: &mut Master, word: usize) -> u16 {
    let eeprom = device(master).eeprom();
    u16::from_le_bytes([eeprom[2 * word], eeprom[2 * word + 1]])
}

/// Gives it alias 7. With that the checksum is CFh.
fn write_alias(master: &mut Master) {
    write(master, 4, 7);
    write(master, 7, 0xCF);
}

fn cycle_power(master: &mut Master) {
    let now = master.now;
    device(master).power_off();
    device(master).power_on(now);
    master.exchange(APWR, 0, 0x0010, &STATION.to_le_bytes());
}

#[test]
fn a_word_is_written_with_write_enable_alone() {
    let mut master = master_of(personality::coupler());
    master.write(STATION, 0x0508, &[7, 0]);
    command(&mut master, WRITE & !1, 4);
    assert_eq!(status(&mut master) & 0x6000, 0x4000);
    assert_eq!(word(&mut master, 4), 0);
    command(&mut master, WRITE, 4);
    assert_eq!(status(&mut master) & 0x6000, 0);
    assert_eq!(word(&mut master, 4), 7);
}

#[test]
fn while_the_eeprom_is_at_work_on_a_word_it_acknowledges_nothing_and_without_power_the_word_is_erased()
 {
    let mut master = master_of(personality::coupler());
    device(&mut master).set_sii_write_delay(5 * MS);
    write(&mut master, 4, 7);
    command(&mut master, READ, 4);
    assert_eq!(status(&mut master) & 0xA000, 0x2000);
    master.now += 5 * MS;
    command(&mut master, READ, 4);
    assert_eq!(status(&mut master) & 0xA000, 0);
    assert_eq!(master.read::<2>(STATION, 0x0508), [7, 0]);
    write(&mut master, 4, 8);
    cycle_power(&mut master);
    assert_eq!(word(&mut master, 4), 0xFFFF);
}

#[test]
fn a_written_alias_counts_after_a_power_up_and_after_a_reload_where_that_takes_it_over() {
    for (reload, error, after) in [
        (EepromReload::Refused, 0x2000, 0),
        (EepromReload::WithoutAlias, 0, 0),
        (EepromReload::WithAlias, 0, 7),
    ] {
        let mut master = master_of(personality::coupler());
        device(&mut master).set_eeprom_reload(reload);
        write_alias(&mut master);
        assert_eq!(alias(&mut master), 0);
        command(&mut master, RELOAD, 0);
        assert_eq!(status(&mut master) & 0x7800, error, "{reload:?}");
        assert_eq!(alias(&mut master), after, "{reload:?}");
        cycle_power(&mut master);
        assert_eq!(alias(&mut master), 7, "{reload:?}");
    }
}

#[test]
fn without_a_right_checksum_at_power_up_the_registers_answer_and_the_processor_does_not() {
    let mut master = master_of(personality::coupler());
    write(&mut master, 4, 7);
    command(&mut master, RELOAD, 0);
    assert_eq!(status(&mut master) & 0x1800, 0x1800);
    cycle_power(&mut master);
    assert_eq!(status(&mut master) & 0x1800, 0x1800);
    assert_eq!(alias(&mut master), 0);
    // DL status: neither loaded nor a processor.
    assert_eq!(master.read::<1>(STATION, 0x0110)[0] & 0x03, 0);
    assert_eq!(master.request(STATION, 2), (1, 0));
    master.write(STATION, 0x0500, &[0]);
    write_alias(&mut master);
    cycle_power(&mut master);
    assert_eq!(alias(&mut master), 7);
    assert_eq!(master.read::<1>(STATION, 0x0110)[0] & 0x03, 3);
}

#[test]
fn an_eeprom_that_the_processor_serves_is_busy_for_its_time_and_is_served_without_a_checksum() {
    let mut master = master_of(personality::akd2g());
    device(&mut master).set_sii_write_delay(200 * MS);
    write(&mut master, 4, 7);
    assert_eq!(status(&mut master) & 0x8020, 0x8020);
    master.now += 200 * MS;
    assert_eq!(status(&mut master) & 0x8020, 0x0020);
    cycle_power(&mut master);
    assert_eq!(status(&mut master) & 0x1800, 0x1800);
    command(&mut master, READ, 4);
    assert_eq!(master.read::<2>(STATION, 0x0508), [7, 0]);
    // With its processor nobody serves it.
    device(&mut master).freeze(true);
    command(&mut master, READ, 4);
    master.now += 10_000 * MS;
    assert_eq!(status(&mut master) & 0x8000, 0x8000);
}
