// Sorts and filters the cards; the address keeps what is chosen (#action=sit&order=worst:ours).
// Without scripts the cards stand in the order of the run.
(function () {
  "use strict";
  // Inside Snakemake's report this page has no folder, so relative links lead nowhere.
  if (location.protocol === "data:" || window.self !== window.top) {
    document.documentElement.classList.add("inside-report");
    for (const link of document.querySelectorAll("a.page")) link.removeAttribute("href");
  }
  const list = document.getElementById("cards");
  if (!list) return;
  const cards = Array.from(list.children);
  // A picture is read when its card comes near: browsers read all `data:` pictures at once, even
  // those that are to be loaded lazily, and a thousand of them take seconds.
  const show = (card) => {
    const picture = card.querySelector("img[data-src]");
    if (!picture) return;
    picture.src = picture.dataset.src;
    picture.removeAttribute("data-src");
  };
  const near = new IntersectionObserver((entries) => {
    for (const entry of entries) {
      if (!entry.isIntersecting) continue;
      near.unobserve(entry.target);
      show(entry.target);
    }
  }, { rootMargin: "600px 0px" });
  for (const card of cards) near.observe(card);
  window.addEventListener("beforeprint", () => cards.forEach(show));
  const by = (id) => document.getElementById(id);
  const sort = by("sort"), search = by("search"), cause = by("cause"), whose = by("cause-method");
  const filters = Array.from(document.querySelectorAll("select[data-filter]"));
  const count = by("count");
  const error = (card, method) => {
    const value = card.dataset["error" + method];
    return value === "" ? Infinity : Number(value);  // a frame without a result is the worst
  };
  const caused = (card) => {
    if (!cause || !cause.value) return true;
    const method = whose ? whose.value : "";
    return card.dataset.causes.split(";").some((entry) => {
      const at = entry.indexOf("=");
      return entry.slice(at + 1) === cause.value && (!method || entry.slice(0, at) === method);
    });
  };
  const remember = () => {
    const chosen = new URLSearchParams();
    const key = sort.selectedOptions[0].dataset.key;
    if (key !== "run") chosen.set("order", key);
    for (const filter of filters) if (filter.value) chosen.set(filter.dataset.filter, filter.value);
    if (cause && cause.value) chosen.set("cause", cause.value);
    if (whose && whose.value) chosen.set("method", whose.value);
    if (search.value) chosen.set("search", search.value);
    const text = chosen.toString();
    try { history.replaceState(null, "", text ? "#" + text : "#frames"); } catch (refused) { /* in a report */ }
  };
  let order = "";
  const apply = () => {
    const text = search.value.trim().toLowerCase();
    let visible = 0;
    for (const card of cards) {
      const keep = (!text || card.dataset.text.toLowerCase().includes(text)) && caused(card) &&
        filters.every((filter) => !filter.value || card.dataset[filter.dataset.filter] === filter.value);
      card.hidden = !keep;
      card.style.display = keep ? "" : "none";
      visible += keep ? 1 : 0;
    }
    count.textContent = `${visible} of ${cards.length} shown`;
    if (order === sort.value) return;
    order = sort.value;
    const [how, method] = order.split(" ");
    const ranked = cards.map((card, index) => [card, index, how === "run" ? 0 : error(card, method)]);
    ranked.sort((a, b) => {
      const way = a[2] === b[2] ? 0 : how === "worst" ? (b[2] > a[2] ? 1 : -1) : (a[2] > b[2] ? 1 : -1);
      return way || a[1] - b[1];
    });
    list.append(...ranked.map((entry) => entry[0]));
  };
  const restore = () => {
    const told = new URLSearchParams(location.hash.slice(1));
    if (!Array.from(told.keys()).some((key) => key !== "frames" && key !== "causes")) return false;
    const set = (select, value) => {
      if (select) select.value = Array.from(select.options).some((o) => o.value === value) ? value : "";
    };
    const option = Array.from(sort.options).find((o) => o.dataset.key === told.get("order"));
    sort.value = (option || sort.options[0]).value;
    for (const filter of filters) set(filter, told.get(filter.dataset.filter) || "");
    set(cause, told.get("cause") || "");
    set(whose, told.get("method") || "");
    search.value = told.get("search") || "";
    return true;
  };
  const change = () => { apply(); remember(); };
  for (const control of [sort, cause, whose, ...filters]) if (control) control.addEventListener("change", change);
  search.addEventListener("input", change);
  by("clear").addEventListener("click", () => {
    for (const control of [sort, cause, whose, ...filters]) if (control) control.selectedIndex = 0;
    search.value = "";
    change();
  });
  const follow = () => {
    if (!restore()) return;
    apply();
    by("frames").scrollIntoView();
  };
  window.addEventListener("hashchange", follow);
  apply();
  follow();
})();
