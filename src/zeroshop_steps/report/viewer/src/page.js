// What every page does without 3D: day and night, sorting of tables, finding in the gallery, a quick look, ways between objects.

const root = document.documentElement;

function remembered(key, value) {
  try {
    if (value !== undefined) localStorage.setItem(key, value);
    return localStorage.getItem(key);
  } catch {
    return null; // some browsers keep nothing for pages from disk
  }
}

function theme() {
  const saved = remembered("zeroshop-theme");
  if (saved) root.dataset.theme = saved;
  const button = document.querySelector("[data-theme-button]");
  button?.addEventListener("click", () => {
    const dark = root.dataset.theme ? root.dataset.theme === "dark" : matchMedia("(prefers-color-scheme: dark)").matches;
    root.dataset.theme = dark ? "light" : "dark";
    remembered("zeroshop-theme", root.dataset.theme);
    document.dispatchEvent(new Event("zeroshop-theme"));
  });
}

function valueOf(cell) {
  const text = cell?.dataset.sort ?? cell?.textContent.trim() ?? "";
  return text !== "" && !Number.isNaN(Number(text)) ? Number(text) : text;
}

function compare(a, b) {
  if (a === "" || b === "") return (a === "") - (b === ""); // empty cells stay below
  if (typeof a === typeof b) return typeof a === "number" ? a - b : a.localeCompare(b, undefined, { numeric: true });
  return typeof a === "number" ? -1 : 1;
}

function sortable(table) {
  const body = table.tBodies[0];
  [...table.tHead.rows[table.tHead.rows.length - 1].cells].forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      [...table.tHead.querySelectorAll("th")].forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const rows = [...body.rows].map((row) => [valueOf(row.cells[column]), row]);
      rows.sort(([a], [b]) => (a === "" || b === "" || up ? compare(a, b) : compare(b, a)));
      body.append(...rows.map(([, row]) => row));
    });
  });
}

function gallery() {
  const words = document.querySelector("[data-find]");
  const cards = [...document.querySelectorAll("[data-card]")];
  const none = document.querySelector("[data-none-found]");
  const grades = [...document.querySelectorAll("[data-grade-filter]")];
  const filter = () => {
    const text = words.value.trim().toLocaleLowerCase();
    const wanted = grades.filter((box) => box.checked).map((box) => box.value);
    cards.forEach((card) => (card.hidden = !card.dataset.card.toLocaleLowerCase().includes(text) || !wanted.includes(card.dataset.grade)));
    none.hidden = cards.some((card) => !card.hidden);
  };
  words?.addEventListener("input", filter);
  grades.forEach((box) => box.addEventListener("change", filter));
}

function quickLook() {
  const dialog = document.querySelector("dialog[data-look]");
  const script = (source) =>
    new Promise((resolve, reject) => {
      if (window.zeroshop?.mount) return resolve();
      document.head.append(Object.assign(document.createElement("script"), { src: source, onload: resolve, onerror: reject }));
    });
  let viewer = null;
  const put = (made) => {
    viewer?.dispose();
    viewer = made;
  };
  document.querySelectorAll("[data-look-at]").forEach((button) =>
    button.addEventListener("click", async () => {
      dialog.querySelector("h2").textContent = button.dataset.name;
      dialog.querySelector("a").href = button.dataset.page;
      const place = document.createElement("div");
      place.className = "viewer";
      place.setAttribute("aria-busy", "true");
      dialog.querySelector("[data-place]").replaceChildren(place);
      dialog.showModal();
      await script(dialog.dataset.look);
      const made = await window.zeroshop.mount(place, button.dataset.lookAt);
      if (place.isConnected) put(made);
      else made?.dispose();
    }),
  );
  dialog?.querySelector("[data-close]").addEventListener("click", () => dialog.close());
  dialog?.addEventListener("close", () => {
    put(null);
    dialog.querySelector("[data-place]").replaceChildren();
  });
}

function neighbours() {
  const place = document.querySelector("[data-neighbours]");
  const objects = window.zeroshopObjects;
  if (!place || !objects) return;
  const here = objects.findIndex(([name]) => name === place.dataset.neighbours);
  const link = (step, text, key) => {
    const [name, page] = objects[(here + step + objects.length) % objects.length];
    const made = Object.assign(document.createElement("a"), { href: `../../${page}`, textContent: text.replace("NAME", name), title: `key ${key}` });
    addEventListener("keydown", (event) => {
      if (event.key === key && !event.ctrlKey && !event.metaKey && !/INPUT|SELECT/.test(event.target.tagName)) location.href = made.href;
    });
    return made;
  };
  if (here >= 0 && objects.length > 1) place.replaceChildren(link(-1, "← NAME", "["), link(1, "NAME →", "]"));
}

theme();
document.querySelectorAll("table[data-sortable]").forEach(sortable);
gallery();
quickLook();
neighbours();
// What is folded away is printed, too, and a link into it opens it.
addEventListener("beforeprint", () => document.querySelectorAll("details").forEach((part) => (part.open = true)));
const reveal = () => {
  const target = location.hash && document.getElementById(decodeURIComponent(location.hash.slice(1)));
  for (let part = target; part; part = part.parentElement) if (part.tagName === "DETAILS") part.open = true;
  target?.scrollIntoView?.();
};
addEventListener("hashchange", reveal);
reveal();
