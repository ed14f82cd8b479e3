//! Conversations from the fact sheet (`instruments/keysight-34980a.md`), section by section: `>` is sent, `<` is the
//! reply, `.` means no reply. They test the grammar that driver and simulator share.

mod stand_in;

use stand_in::{Sheet, mainframe, say};

fn holds(modules: &[&str], conversation: &str) {
    let (mut unit, mut sheet) = (mainframe(modules), Sheet::default());
    let mut answer = None;
    for line in conversation.lines().map(str::trim) {
        match line.split_at_checked(1) {
            Some((">", line)) => answer = say(&mut unit, &mut sheet, line.trim()),
            Some(("<", expected)) => {
                assert_eq!(
                    answer.as_deref(),
                    Some(expected.trim()),
                    "in\n{conversation}"
                );
            }
            Some((".", _)) => assert_eq!(answer, None, "in\n{conversation}"),
            _ => assert!(line.is_empty(), "'{line}' begins with none of > < ."),
        }
    }
}

#[test]
fn section_1_who_it_is_and_what_it_holds() {
    holds(
        &["34924A", "", "34934A,8x64", "34934A,none"],
        "> *IDN?
         < Agilent Technologies,34980A,MY44000001,2.43-2.43-0.00-0.00
         > SYST:CTYP? 1
         < Agilent Technologies,34924A,MY44900001,1.00
         > SYST:CTYP? 2
         < Agilent Technologies,0,0,0
         > SYSTEM:CTYPE? 3
         < Agilent Technologies,34934A-8x64,MY44900003,1.00
         > SYST:CTYP? 4
         < Agilent Technologies,34934A-4x32,MY44900004,1.00
         > SYST:MOD:TERM:TYPE? 3;TYPE? 4;TYPE? 1
         < R8_R64;NONE;34924T
         > SYST:CTYP? 9
         .
         > SYST:ERR?
         < -222,\"Data out of range\"",
    );
}

#[test]
fn section_2_ranges_skip_bus_relays_and_must_end_on_channels() {
    holds(
        &["34924A", "34922A"],
        "> ROUT:SCAN (@1010:1008);SCAN?
         < #217(@1008,1009,1010)
         > ROUT:SCAN (@1070:2002);:ROUT:SCAN?
         < #217(@1070,2001,2002)
         > ROUT:SCAN (@1001:1911)
         > SYST:ERR?
         < +112,\"Channel list: channel number out of range\"
         > ROUT:SCAN (@1001:1071);:SYST:ERR?
         < +112,\"Channel list: channel number out of range\"
         > ROUT:CLOS (@3001);:SYST:ERR?
         < +111,\"Channel list: slot number out of range\"
         > ROUT:SCAN (@);:ROUT:SCAN?
         < #13(@)",
    );
}

#[test]
fn section_4_switching() {
    holds(
        &["34924A", "34932A"],
        "> ROUT:CLOS (@1036,2101)
         .
         > ROUT:CLOS? (@2101,1036,1037)
         < 1,1,0
         > ROUT:OPEN? (@2101,1036,1037)
         < 0,0,1
         > ROUT:CLOS:EXCL (@1040)
         > ROUT:CLOS? (@1036,1040,2101)
         < 0,1,1
         > ROUT:CLOS (@2921,1911,1912);:ROUT:OPEN:ABUS 1
         > ROUT:CLOS? (@2921,1911,1912)
         < 0,0,1
         > ROUT:OPEN:ALL 1;:ROUT:CLOS? (@1040,1912,2101)
         < 0,0,1
         > ROUT:OPEN:ALL;:ROUT:CLOS? (@2101)
         < 0
         > DIAG:REL:CYCL? (@1036,1037,2101)
         < +1,+0,+1",
    );
}

#[test]
fn section_4_a_bank_in_the_scan_list_is_committed() {
    holds(
        &["34924A"],
        "> CONF:VOLT:DC 1,(@1001:1026)
         > ROUT:CLOS (@1030);:SYST:ERR?
         < +301,\"Module currently committed to scan\"
         > ROUT:CLOS (@1911);:SYST:ERR?
         < +301,\"Module currently committed to scan\"
         > ROUT:CLOS (@1921);:SYST:ERR?
         < +301,\"Module currently committed to scan\"
         > ROUT:CLOS (@1036);:SYST:ERR?;:ROUT:CLOS? (@1036)
         < +0,\"No error\";1",
    );
}

#[test]
fn section_5_configuring() {
    holds(
        &["34924A", "34932A"],
        "> FORM:READ:UNIT ON;:CONF:VOLT:DC 0.5,(@1001:1003);:FORM:READ:UNIT?
         < 0
         > ROUT:SCAN:SIZE?
         < +3
         > VOLT:DC:NPLC? (@1001:1003)
         < +1.00000000E+00,+1.00000000E+00,+1.00000000E+00
         > CONF? (@1002)
         < \"VOLT +1.000000E+00,+3.000000E-06\"
         > VOLT:DC:NPLC 0.02,(@1002);:VOLT:DC:NPLC? (@1001,1002)
         < +1.00000000E+00,+2.00000000E-02
         > ROUT:CHAN:DEL? (@1001)
         < +1.00000000E-03
         > ROUT:CHAN:DEL 0,(@1001:1003);:ROUT:CHAN:DEL? (@1003)
         < +0.00000000E+00
         > CONF:VOLT:DC 10,1E-5,(@1001);:VOLT:DC:NPLC? (@1001)
         < +1.00000000E+01
         > VOLT:DC:RANG? (@1001)
         < +1.00000000E+01
         > VOLT:DC:ZERO:AUTO OFF,(@1001);:VOLT:DC:ZERO:AUTO? (@1001)
         < 0
         > VOLT:DC:IMP:AUTO ON,(@1001);:VOLT:DC:IMP:AUTO? (@1001)
         < 1
         > TRIG:SOUR?;COUN?
         < IMM;+1
         > ROUT:SCAN (@2101);:SYST:ERR?
         < +308,\"Channel not able to perform requested operation\"
         > READ? (@2101)
         .",
    );
}

#[test]
fn section_5_readings_to_the_byte() {
    holds(
        &["34924A"],
        "> CONF:VOLT:DC 10,(@1001:1002);:ROUT:CLOS (@1037)
         > READ?
         < +2.00100000E+00,+2.00200000E+00
         > FORM:READ:UNIT ON;CHAN ON
         > READ?
         < +2.00100000E+00 VDC,1001,+2.00200000E+00 VDC,1002
         > FORM:READ:TIME ON;ALAR ON;:ROUT:SCAN (@1001);:VOLT:NPLC 10,(@1001);:VOLT:DC:ZERO:AUTO OFF,(@1001);:READ?
         < +2.00100000E+00 VDC,000000000.204,1001,0
         > VOLT:DC:RANG 1,(@1001);:FORM:READ:TIME OFF;ALAR OFF;UNIT OFF;CHAN OFF;:READ?
         < +9.90000000E+37
         > STAT:QUES?
         < +1
         > STAT:QUES?
         < +0
         > FETC?
         < +9.90000000E+37
         > VOLT:DC:RANG 10,(@1001);:FETC?
         .
         > SYST:ERR?
         < -230,\"Data corrupt or stale\"",
    );
}

#[test]
fn section_7_status_and_errors() {
    holds(
        &["34924A"],
        "> *ESR?
         < +128
         > *ESR?
         < +0
         > ROUTE:CLOZE (@1001)
         .
         > *STB?;*ESR?
         < +4;+32
         > SYST:ERR?
         < -113,\"Undefined header\"
         > SYST:ERR?
         < +0,\"No error\"
         > ROUT:CLOS (@);:SYST:ERR?
         < +113,\"Channel list: empty scan list\"
         > *ESE 60;*ESE?;*SRE 4;*SRE?
         < +60;+4
         > *OPC?;*TST?
         < 1;+0
         > *OPC;*ESR?
         < +9
         > *OPC
         > *ESR?
         < +1
         > *TRG;:SYST:ERR?
         < -211,\"Trigger ignored\"
         > TRIG:SOUR BUS;:READ?
         .
         > INIT;:INIT;:SYST:ERR?;:SYST:ERR?
         < -214,\"Trigger deadlock\";-213,\"Init ignored\"
         > STAT:OPER:COND?;:ABOR;:STAT:OPER:COND?
         < +32;+0",
    );
}

#[test]
fn section_9_the_fastest_legal_sequence() {
    holds(
        &["34924A"],
        "> *RST;*CLS
         > CONF:VOLT:DC 10,(@1001:1003)
         > VOLT:DC:NPLC 1,(@1001:1003)
         > ROUT:CHAN:DEL 0,(@1001:1003)
         > VOLT:DC:ZERO:AUTO OFF,(@1001:1003)
         > TRIG:COUN 1
         > ROUT:CLOS (@1036)
         .
         > READ?
         < +1.00100000E+00,+1.00200000E+00,+1.00300000E+00
         > ROUT:CLOS (@1037);:ROUT:OPEN (@1036);:READ?
         < +2.00100000E+00,+2.00200000E+00,+2.00300000E+00
         > SYST:ERR?
         < +0,\"No error\"",
    );
}

#[test]
fn section_3_rows_pairs_and_coils() {
    holds(
        &["34934A,4x32", "34925A", "34923A", "34934A,8x64"],
        "> SYSTem:MODule:ROW:PROTection? 1
         < AUTO100
         > SYST:MOD:ROW:PROT 1,ISO;PROT? 1
         < ISO
         > SYST:MOD:ROW:PROT 2,FIX;:SYST:ERR?
         < +305,\"Not able to perform requested operation\"
         > ROUT:CLOS:PAIR (@1101,1135)
         > ROUT:CLOS? (@1101,1165,1135,1199);:ROUT:CLOS:PAIR? (@1101,1102)
         < 1,1,1,1;1,0
         > ROUT:OPEN (@1165);:ROUT:CLOS:PAIR? (@1101);:ROUT:OPEN:PAIR? (@1101)
         < 0;0
         > ROUT:OPEN:PAIR (@1101);:ROUT:OPEN? (@1101,1165)
         < 1,1
         > ROUT:CLOS:PAIR (@4101);:SYST:ERR?
         < +308,\"Channel not able to perform requested operation\"
         > ROUT:CLOS (@2001,2021);:ROUT:CLOS (@2002);:SYST:ERR?
         < +305,\"Not able to perform requested operation\"
         > ROUT:CLOS (@3001:3010);:ROUT:CLOS (@3911);:SYST:ERR?
         < +305,\"Not able to perform requested operation\"
         > DIAG:REL:CYCL? (@2001,3001)
         < +0,+1
         > DIAG:REL:CYCL:CLE (@3001);:DIAG:REL:CYCL? (@3001)
         < +0
         > *RST;:SYST:MOD:ROW:PROT? 1
         < AUTO100",
    );
}

#[test]
fn section_5_limits_and_integration() {
    holds(
        &["34922A"],
        "> CONF:VOLT:DC 10,MIN,(@1001);:VOLT:DC:NPLC? (@1001)
         < +1.00000000E+02
         > CONF:VOLT:DC 10.0, 0.003, (@1001);:VOLT:DC:NPLC? (@1001)
         < +2.00000000E-02
         > VOLT:DC:NPLC? MIN,(@1001);NPLC? MAX
         < +2.00000000E-02;+2.00000000E+02
         > VOLT:DC:RANG? MIN;RANG? MAX
         < +1.00000000E-01;+3.00000000E+02
         > VOLT:DC:APER 301 us,(@1001);APER? (@1001);APER:ENAB? (@1001)
         < +3.00000000E-04;1
         > VOLT:DC:NPLC 1,(@1001);APER:ENAB? (@1001)
         < 0
         > VOLT:DC:RES 1E-5,(@1001);RES? (@1001);NPLC? (@1001)
         < +1.00000000E-05;+1.00000000E+01
         > VOLT:DC:RANG:AUTO ON,(@1001);:VOLT:DC:RANG:AUTO? (@1001);:CONF? (@1001)
         < 1;\"VOLT AUTO\"
         > CONF:VOLT:DC AUTO,0.001,(@1001);:SYST:ERR?
         < -221,\"Settings conflict\"
         > ROUT:CHAN:DEL 0.0024;DEL?;DEL:AUTO?
         < +2.00000000E-03;0
         > ROUT:CHAN:DEL:AUTO ON;:ROUT:CHAN:DEL?
         < +2.00000000E-03
         > ROUT:CHAN:DEL? MAX
         < +6.00000000E+01
         > TRIG:TIM? MAX;COUN? MAX;COUN? MIN
         < +3.59999999E+05;+50000;+1",
    );
}

#[test]
fn section_5_time_stamps() {
    holds(
        &["34922A"],
        "> SYST:DATE 2024,2,28;TIME 23,59,59.9;DATE?;TIME?
         < 2024,02,28;23,59,59.900
         > CONF:VOLT:DC 10,(@1001:1002);:VOLT:DC:ZERO:AUTO OFF,(@1001:1002)
         > FORM:READ:TIME ON;TIME:TYPE ABS;TYPE?
         < ABS
         > FORM:READ:UNIT ON;CHAN ON;ALAR ON
         > ROUT:CHAN:DEL 0.1;:READ?
         < +0.00000000E+00 VDC,2024,02,29,00,00,00.029,1001,0,+0.00000000E+00 VDC,2024,02,29,00,00,00.159,1002,0
         > SYST:TIME:SCAN?
         < 2024,02,28,23,59,59.900
         > FORM:READ:TIME:TYPE REL;:READ? (@1002)
         < +0.00000000E+00 VDC,000000000.130,1002,0",
    );
}

#[test]
fn section_5_memory() {
    holds(
        &["34924A"],
        "> FETC?
         .
         > SYST:ERR?
         < -230,\"Data corrupt or stale\"
         > CONF:VOLT:DC 10,(@1001:1003);:INIT;:*OPC?
         < 1
         > DATA:POIN?
         < +3
         > R? 1
         < #215+0.00000000E+00
         > DATA:REM? 3
         .
         > SYST:ERR?
         < -222,\"Data out of range\"
         > DATA:REM? 2
         < +0.00000000E+00,+0.00000000E+00
         > R?
         < #10
         > READ? (@1002);:DATA:POIN?;:TRIG:COUN 2;:DATA:POIN?
         < +0.00000000E+00;+1;+0
         > MEAS:VOLT:DC? 1,(@1001);:ROUT:SCAN?
         < +0.00000000E+00;#17(@1001)",
    );
}

#[test]
fn section_6_sequences() {
    holds(
        &["34924A"],
        "> ROUT:SEQ:CAT?
         < \"\"
         > ROUTe:SEQuence:DEFine MySeq_1,\"ROUTe:CLOSe (@1001:1009);:ROUTe:OPEN (@1001)\"
         > ROUT:SEQ:DEF? mySEQ_1
         < \":ROUT:CLOS (@1001:1009);:ROUT:OPEN (@1001)\"
         > ROUT:SEQ:DEF Other,'ROUT:SEQ:TRIG MYSEQ_1;:DISP:TEXT \"done\"'
         > ROUT:SEQ:CAT?
         < \"MYSEQ_1\",\"OTHER\"
         > ROUT:SEQ:TRIG OTHER;WAIT;BUSY?;:ROUT:CLOS? (@1001,1002,1009);:DISP:TEXT?
         < 0;0,1,1;\"done\"
         > ROUT:SEQ:DEF MYSEQ_1,\"ROUT:CLOS (@1001);:READ?\"
         > SYST:ERR?;:ROUT:SEQ:DEF? MYSEQ_1
         < -221,\"Settings conflict\";\":ROUT:CLOS (@1001:1009);:ROUT:OPEN (@1001)\"
         > ROUT:SEQ:DEF MYSEQ_1,\"ROUT:KLOS (@1001)\";:SYST:ERR?
         .
         > SYST:ERR?
         < -113,\"Undefined header\"
         > ROUT:SEQ:DEL OTHER;CAT?
         < \"MYSEQ_1\"
         > ROUT:SEQ:DEL:ALL;:ROUT:SEQ:CAT?
         < \"\"",
    );
}

#[test]
fn section_7_summaries() {
    holds(
        &["34924A"],
        "> STAT:OPER:ENAB 16;ENAB?;:STAT:QUES:ENAB 4097;ENAB?
         < +16;+4097
         > *CLS;*SRE 136
         > CONF:VOLT:DC 0.1,(@1001);:ROUT:CLOS (@1036);:READ?
         < +9.90000000E+37
         > *STB?
         < +200
         > STAT:OPER?;:STAT:QUES?;:*STB?
         < +784;+1;+16
         > STAT:PRES;:STAT:OPER:ENAB?;:STAT:QUES:ENAB?
         < +0;+0",
    );
}
