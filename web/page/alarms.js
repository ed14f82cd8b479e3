"use strict";
// The list of alarms, and the commands of a page that may control.

class AlarmList {
  // send: sends a command and resolves when it is done
  constructor(table, send) {
    this.table = table;
    this.send = send;
    this.shown = "";
  }

  // returns the names of those that notify
  show(alarms, control) {
    const matter = alarms.filter(alarm => alarm.active || !alarm.acknowledged || alarm.level === "invalid" || alarm.shelved || alarm.out_of_service);
    const text = JSON.stringify([matter, control]);
    const calling = alarms.filter(alarm => alarm.active && !alarm.shelved && !alarm.out_of_service).map(alarm => alarm.name);
    // buttons must not change under the pointer
    if (text === this.shown) return calling;
    this.shown = text;
    const rows = matter.map(alarm => this.row(alarm, control));
    if (!rows.length) rows.push(row([alarms.length ? "no alarm is active or waits to be acknowledged" : "this daemon has no alarms"]));
    this.table.replaceChildren(...rows);
    return calling;
  }

  row(alarm, control) {
    const why = !alarm.active && alarm.invalid ? alarm.invalid : alarm.cause || "";
    const tr = row([alarm.name, AlarmList.words(alarm), alarm.active && alarm.guidance ? `${why}. ${alarm.guidance}` : why]);
    tr.className = alarm.active ? alarm.severity : alarm.level === "invalid" ? "invalid" : "";
    if (!control) return tr;
    const cell = document.createElement("td");
    const add = (words, command) => {
      const button = document.createElement("button");
      button.textContent = words;
      button.setAttribute("aria-label", `${words} ${alarm.name}`);
      button.addEventListener("click", () => this.send({ ...command, name: alarm.name }));
      cell.append(button, " ");
    };
    if (!alarm.acknowledged) add("Acknowledge", { call: "acknowledge" });
    if (alarm.held) add("Reset", { call: "reset" });
    if (alarm.shelved) add("Unshelve", { call: "unshelve" });
    else if (alarm.active) add("Shelve 30 min", { call: "shelve", for_s: 1800 });
    tr.append(cell);
    return tr;
  }

  static words(alarm) {
    const words = [alarm.active ? `ACTIVE, ${alarm.severity}` : alarm.level === "invalid" ? "CANNOT BE JUDGED" : alarm.level || "not judged now"];
    if (!alarm.acknowledged) words.push("not acknowledged");
    if (alarm.held) words.push("waits for a reset");
    if (alarm.shelved) words.push(`shelved ${alarm.shelved}`);
    if (alarm.out_of_service) words.push(`out of service ${alarm.out_of_service}`);
    return words.join(", ");
  }
}
