// Sorts and filters the cards. Without scripts the cards stand in the order of the run.
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
  const sort = document.getElementById("sort"), search = document.getElementById("search");
  const filters = Array.from(document.querySelectorAll("select[data-filter]"));
  const count = document.getElementById("count");
  const original = new Map(cards.map((card, index) => [card, index]));
  const error = (card, method) => {
    const value = card.dataset["error" + method];
    return value === "" ? Infinity : Number(value);  // a frame without a result is the worst
  };
  const apply = () => {
    const text = search.value.trim().toLowerCase();
    let visible = 0;
    for (const card of cards) {
      const keep = (!text || card.dataset.text.toLowerCase().includes(text)) &&
        filters.every((filter) => !filter.value || card.dataset[filter.dataset.filter] === filter.value);
      card.hidden = !keep;
      card.style.display = keep ? "" : "none";
      visible += keep ? 1 : 0;
    }
    count.textContent = `${visible} of ${cards.length} shown`;
    const [how, method] = sort.value.split(" ");
    const order = cards.slice().sort((a, b) => {
      const x = error(a, method), y = error(b, method);
      const way = how === "worst" ? (x === y ? 0 : y > x ? 1 : -1)
        : how === "best" ? (x === y ? 0 : x > y ? 1 : -1) : 0;
      return way || original.get(a) - original.get(b);
    });
    list.append(...order);
  };
  for (const control of [sort, ...filters]) control.addEventListener("change", apply);
  search.addEventListener("input", apply);
  apply();
})();
